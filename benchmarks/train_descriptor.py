#!/usr/bin/env python3
"""Train the descriptor of contacts on generated parts, and write its weights as a safetensors file.

Each part has keys, which are the patches of its places, and queries, which are patches of the same part in other
directions. A query is shown as a touch: in a rotated gel that sees only a part of it, pressed by 0.2 to 1.2 mm, with
noise, and sometimes with a blurred surface, as an elastic gel has. The networks learn to give a query a high similarity
to the keys of its own part, and the highest to the keys nearest to it (Oord et al., 2018: InfoNCE).

The families of `--families` take part in training. Evaluate with other families only.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from generated_parts import FAMILIES, list_names, make_mesh
from numpy.typing import NDArray
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional

from tactile_loc.core.descriptor.features import ANGLES, RADII_M, RAMPS_M
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.places import BELOW, PATCH_PX, PITCH_M, STEP_M, Places
from tactile_loc.core.slots.registry import registry
from tactile_loc.io.meshes import load_object

HELD_OUT = ("gear", "clip", "fitting", "cam")
KEY_DIRECTIONS, QUERY_DIRECTIONS = 800, 331
MOST_QUERIES, NEAREST = 400, 4
LEVER_M = 0.01  # a rotation by an angle counts as this distance times the angle
PARTS, QUERIES, KEYS = 384, 2, 48  # per step: parts, queries of each part, and keys of each part
EPS = 1e-12


class Part(NamedTuple):
    """A part's key patches (K, S, S) and query patches (Q, S, S), and the numbers (Q, NEAREST) of the nearest keys."""

    keys: NDArray[np.uint8]
    queries: NDArray[np.uint8]
    nearest: NDArray[np.int64]


def find_places(obj: ObjectModel, directions: int) -> Places:
    """Return the places of an object for a number of directions."""
    return registry().create("grid", "whole", {"directions": directions}).places(obj, Progress())


def make_training_part(name: str, folder: Path) -> Part | None:
    """Return the keys and queries of a generated part; None if its places cannot be found."""
    path = folder / f"{name}.stl"
    make_mesh(name).export(path)
    obj = load_object(str(path), units="mm")
    keys, queries = find_places(obj, KEY_DIRECTIONS), find_places(obj, QUERY_DIRECTIONS)
    rng = np.random.default_rng(len(keys))
    some = np.sort(rng.permutation(len(queries))[:MOST_QUERIES])
    ours, theirs = queries.placements[some], keys.placements
    off_m = np.linalg.norm(ours[:, None, :3] - theirs[None, :, :3], axis=2)
    turned = LEVER_M * np.arccos(np.clip(ours[:, 3:] @ theirs[:, 3:].T, -1, 1))
    nearest = np.argsort(off_m + turned, axis=1)[:, :NEAREST]
    return Part(keys.patches, queries.patches[some], nearest)


def _make_in_worker(task: tuple[str, Path]) -> Part | None:
    try:
        return make_training_part(*task)
    except Exception as error:  # noqa: BLE001  # one bad part must not end an hour of work
        print(f"{task[0]} is left out: {error}", flush=True)
        return None


class Tower(nn.Module):
    """Maps polar features (B, C, ANGLES) to unit vectors (B, D): three circular convolutions and a pool."""

    def __init__(self, channels: int, widths: tuple[int, int, int], dimensions: int) -> None:
        super().__init__()
        sizes = (channels, *widths)
        self.layers = nn.ModuleList(
            nn.Conv1d(
                sizes[k], sizes[k + 1], 5, stride=1 if k == 0 else 2, padding=2, padding_mode="circular", bias=False
            )
            for k in range(3)
        )
        self.norms = nn.ModuleList(nn.BatchNorm1d(width) for width in widths)
        self.out = nn.Linear(2 * widths[-1], dimensions)

    def forward(self, x: Tensor) -> Tensor:
        """Return the unit vectors (B, D) of features (B, C, ANGLES)."""
        for layer, norm in zip(self.layers, self.norms, strict=True):
            x = functional.relu(norm(layer(x)))
        pooled = torch.cat([x.mean(dim=2), x.amax(dim=2)], dim=1)
        return functional.normalize(self.out(pooled), dim=1)

    def export(self, name: str) -> dict[str, Tensor]:
        """Return the weights, with the norms folded into the convolutions."""
        weights = {}
        for k, (layer, norm) in enumerate(zip(self.layers, self.norms, strict=True)):
            scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
            weights[f"{name}.{k}.weight"] = layer.weight * scale[:, None, None]
            weights[f"{name}.{k}.bias"] = norm.bias - norm.running_mean * scale
        weights[f"{name}.out.weight"], weights[f"{name}.out.bias"] = self.out.weight, self.out.bias
        return {key: value.detach().half().cpu().contiguous() for key, value in weights.items()}


class Descriptor(nn.Module):
    """The two towers, and the temperature of the similarities."""

    def __init__(self, dimensions: int) -> None:
        super().__init__()
        rings, ramps = len(RADII_M), len(RAMPS_M)
        self.keys = Tower(rings * ramps, (96, 128, 160), dimensions)
        self.queries = Tower(2 * rings * ramps, (160, 224, 320), dimensions)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(0.07)))

    @property
    def temperature(self) -> Tensor:
        """The temperature of the similarities, unitless."""
        return self.log_temperature.exp().clamp(min=0.01)


def sample_polar(images: Tensor, yaw_rad: Tensor, shift_m: Tensor, mode: str) -> Tensor:
    """Sample images (B, S, S) at the rings and angles (B, rings, ANGLES), rotated by yaws (B,), shifted by (B, 2)."""
    device = images.device
    radius = torch.as_tensor(RADII_M, dtype=torch.float32, device=device)[None, :, None]
    angle = torch.arange(ANGLES, device=device) * (2 * math.pi / ANGLES)
    angle = angle[None, None, :] + yaw_rad[:, None, None]
    at = torch.stack([radius * angle.cos(), radius * angle.sin()], dim=3) + shift_m[:, None, None, :]
    grid = at / (PITCH_M * PATCH_PX / 2)
    return functional.grid_sample(
        images[:, None], grid.to(images.dtype), mode=mode, padding_mode="border", align_corners=False
    )[:, 0]


def to_heights(patches: Tensor) -> Tensor:
    """Convert patches (B, S, S) to heights, metres, up to the end of the longest ramp."""
    return ((patches.float() - BELOW) * STEP_M).clamp(0, RAMPS_M[-1])


def encode_ramps(height_m: Tensor) -> Tensor:
    """Return the heights (B, rings, ANGLES), metres, on each ramp (B, ramps * rings, ANGLES), 0 to 1."""
    return torch.cat([(height_m / ramp).clamp(max=1) for ramp in RAMPS_M], dim=1)


def show_as_touch(patches: Tensor, generator: torch.Generator) -> Tensor:
    """Return the features (B, C, ANGLES) of patches (B, S, S) that are seen by a gel: see the module's docstring."""
    device, count = patches.device, len(patches)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(count, *shape, generator=generator, device=device)

    height_m = ((patches.float() - BELOW) * STEP_M).clamp(min=0)
    press_m = 1e-3 * torch.exp(uniform(math.log(0.2), math.log(1.2)))
    elastic = uniform(0, 1) < 0.25
    softness_m = 0.08e-3
    blurred = blur(torch.exp(-height_m / softness_m), 1.2)
    sagged = (-softness_m * torch.log(blurred + EPS)).clamp(max=3e-3)
    sagged = sagged - sagged.amin(dim=(1, 2), keepdim=True)
    height_m = torch.where(elastic[:, None, None], sagged, height_m)
    noisy = (uniform(0, 1) < 0.6)[:, None, None]
    strength_m = (uniform(0, 0.06) * press_m)[:, None, None]
    field = blur(torch.randn(height_m.shape, generator=generator, device=device), 1.5)
    field = field / field.std()
    height_m = torch.where(noisy, (height_m + strength_m * field).clamp(min=0), height_m)
    factor = torch.where(noisy[:, 0, 0], torch.exp(0.1 * torch.randn(count, generator=generator, device=device)), 1.0)
    believed_m = press_m * factor
    contact = height_m < press_m[:, None, None]
    depth_m = torch.where(contact, height_m * factor[:, None, None], believed_m[:, None, None])
    depth_m = torch.minimum(depth_m, believed_m[:, None, None])
    depth_m = drop_patches(depth_m, believed_m, noisy, generator)
    shift_m = 1e-3 * uniform(-0.7, 0.7, 2)
    here = functional.grid_sample(
        height_m[:, None], (shift_m / (PITCH_M * PATCH_PX / 2))[:, None, None, :], align_corners=False
    )[:, 0, 0, 0]
    shift_m = torch.where((here < 2e-5)[:, None], shift_m, 0.0)
    yaw_rad = uniform(0, 2 * math.pi)
    seen = draw_gel(count, shift_m.device, generator)
    polar_m = sample_polar(depth_m, yaw_rad, shift_m, "bilinear")
    return encode_seen_ramps(polar_m, seen, believed_m)


def encode_seen_ramps(polar_m: Tensor, seen: Tensor, press_m: Tensor) -> Tensor:
    """Return the features (B, C, ANGLES) of polar depths, and which are known; see `features.encode_touch`."""
    press = press_m[:, None, None]
    touched = polar_m < press
    values = [(polar_m / ramp).clamp(max=1) * seen for ramp in RAMPS_M]
    known = [(seen & (touched | (press >= ramp))).to(polar_m.dtype) for ramp in RAMPS_M]
    return torch.cat(values + known, dim=1)


def draw_gel(count: int, device: torch.device, generator: torch.Generator) -> Tensor:
    """Return which polar samples (count, rings, ANGLES) a random gel sees around a random contact."""

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(count, 1, 1, generator=generator, device=device)

    radius = torch.as_tensor(RADII_M, dtype=torch.float32, device=device)[None, :, None]
    angle = (torch.arange(ANGLES, device=device) * (2 * math.pi / ANGLES))[None, None, :] + uniform(0, 2 * math.pi)
    x, y = radius * angle.cos(), radius * angle.sin()
    width, height = 1e-3 * uniform(13, 24), 1e-3 * uniform(11, 18)
    at_x, at_y = uniform(-0.4, 0.4) * width, uniform(-0.4, 0.4) * height
    return ((x + at_x).abs() < width / 2) & ((y + at_y).abs() < height / 2)


def drop_patches(depth_m: Tensor, press_m: Tensor, noisy: Tensor, generator: torch.Generator) -> Tensor:
    """Miss the contact in a disc of some noisy touches, and add a false contact to some others."""
    count, device = len(depth_m), depth_m.device
    at = (torch.arange(PATCH_PX, device=device) - PATCH_PX // 2) * PITCH_M
    centre = 1e-3 * (torch.rand(count, 2, generator=generator, device=device) * 14 - 7)
    radius = 1e-3 * (0.4 + 1.2 * torch.rand(count, 1, 1, generator=generator, device=device))
    inside = (at[None, None, :] - centre[:, 0, None, None]) ** 2 + (at[None, :, None] - centre[:, 1, None, None]) ** 2
    chosen = torch.rand(count, 1, 1, generator=generator, device=device)
    press = press_m[:, None, None]
    inside = (inside < radius**2) & noisy
    depth_m = torch.where(inside & (chosen < 0.3), press, depth_m)
    return torch.where(inside & (chosen > 0.8), torch.minimum(depth_m, 0.6 * press), depth_m)


def blur(images: Tensor, sigma_px: float) -> Tensor:
    """Blur images (B, S, S) with a Gaussian."""
    reach = math.ceil(3 * sigma_px)
    line = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, device=images.device) / sigma_px) ** 2)
    line = (line / line.sum())[None, None]
    x = functional.pad(images[:, None], (reach, reach, reach, reach), mode="replicate")
    return functional.conv2d(functional.conv2d(x, line[:, :, None, :]), line[:, :, :, None])[:, 0]


def join(parts: list[Part]) -> dict[str, Tensor]:
    """Return the parts' arrays, each joined to one, and the numbers of keys and queries (P,)."""
    joined = {name: torch.from_numpy(np.concatenate([getattr(p, name) for p in parts])) for name in Part._fields}
    counts = {f"{name}_count": [len(getattr(p, name)) for p in parts] for name in ("keys", "queries")}
    return joined | {name: torch.tensor(count) for name, count in counts.items()}


class Data:
    """The keys and queries of all parts, on the device."""

    def __init__(self, joined: dict[str, Tensor], device: torch.device) -> None:
        self.keys, self.queries, self.nearest = (joined[name].to(device) for name in Part._fields)
        self.key_count, self.query_count = (joined[name].to(device) for name in ("keys_count", "queries_count"))
        self.first_key = torch.cumsum(self.key_count, 0) - self.key_count
        self.first_query = torch.cumsum(self.query_count, 0) - self.query_count

    def __len__(self) -> int:
        return len(self.key_count)


def compute_loss(
    model: Descriptor, data: Data, parts: int, place_weight: float, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Return the loss of a batch, nats, and the share of queries whose own part is the most similar one."""
    device = data.keys.device
    chosen = torch.randperm(len(data), generator=generator, device=device)[:parts]
    pick = (
        torch.rand(len(chosen), QUERIES, generator=generator, device=device) * data.query_count[chosen, None]
    ).long()
    queries = (data.first_query[chosen, None] + pick).flatten()
    some = (torch.rand(len(chosen), KEYS, generator=generator, device=device) * data.key_count[chosen, None]).long()
    near = data.nearest[queries].view(len(chosen), QUERIES * NEAREST)
    keys = data.first_key[chosen, None] + torch.cat([some, near], dim=1)
    weight = torch.ones(keys.shape, device=device)
    weight[:, :KEYS] = data.key_count[chosen, None] / KEYS
    patches = data.keys[keys.flatten()]
    zero = torch.zeros(len(patches), device=device)
    turned = 2 * math.pi * torch.rand(len(patches), generator=generator, device=device)
    heights = sample_polar(to_heights(patches), turned, torch.stack([zero, zero], dim=1), "bilinear")
    with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
        code = model.keys(encode_ramps(heights))
        asked = model.queries(show_as_touch(data.queries[queries], generator))
    logits = asked.float() @ code.float().T / model.temperature + weight.flatten().log()
    logits = logits.view(len(queries), len(chosen), -1)
    own = torch.arange(len(queries), device=device) // QUERIES
    every = torch.logsumexp(logits.flatten(1), dim=1)
    by_part = torch.logsumexp(logits, dim=2)
    which = torch.arange(len(queries), device=device)
    loss_part = (every - by_part[which, own]).mean()
    slot = KEYS + (which % QUERIES)[:, None] * NEAREST + torch.arange(NEAREST, device=device)[None]
    positive = torch.logsumexp(torch.gather(logits[which, own], 1, slot), dim=1)
    others = by_part.masked_fill(functional.one_hot(own, len(chosen)).bool(), -torch.inf).logsumexp(dim=1)
    loss_place = (torch.logaddexp(others, positive) - positive).mean()
    first = (by_part.argmax(dim=1) == own).float().mean()
    return loss_part + place_weight * loss_place, first


def train(data: Data, held: Data | None, arguments: argparse.Namespace) -> Descriptor:
    """Train for some minutes and return the model. The learning rate follows a cosine over this time."""
    device, minutes, settings = data.keys.device, arguments.minutes, (arguments.batch, arguments.place_weight)
    torch.manual_seed(arguments.seed)
    model = Descriptor(arguments.dimensions).to(device)
    generator = torch.Generator(device).manual_seed(arguments.seed)
    optimiser = torch.optim.AdamW(model.parameters(), lr=2e-3, weight_decay=1e-3)
    start, step, shown = time.monotonic(), 0, 0.0
    while (share := (time.monotonic() - start) / (60 * minutes)) < 1:
        for group in optimiser.param_groups:
            group["lr"] = 2e-3 * min(1.0, step / 200) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))
        loss, first = compute_loss(model, data, *settings, generator)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        step += 1
        if share >= shown:
            shown += 0.05
            text = f"{share:4.0%} step {step}: loss {loss.item():.3f}, first {first.item():.1%}"
            if held is not None:
                model.eval()
                with torch.no_grad():
                    tried = [compute_loss(model, held, *settings, generator) for _ in range(8)]
                model.train()
                text += f"; held out: loss {np.mean([t[0].item() for t in tried]):.3f}, "
                text += f"first {np.mean([t[1].item() for t in tried]):.1%}"
            print(f"{text}, temperature {model.temperature.item():.4f}", flush=True)
    return model.eval()


def make_parts(arguments: argparse.Namespace) -> list[dict[str, Tensor]]:
    """Return the joined training parts and, if there are any, the joined held-out parts."""
    arguments.meshes.mkdir(parents=True, exist_ok=True)
    others = [family for family in FAMILIES if family not in arguments.families]
    sets = []
    with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
        for families, count in ((arguments.families, arguments.parts), (others, arguments.held_out)):
            if families and count:
                tasks = [(name, arguments.meshes) for name in list_names(count, families)]
                parts = [part for part in pool.imap(_make_in_worker, tasks, chunksize=2) if part is not None]
                sets.append(join(parts))
    return sets


def main() -> None:
    """Make the parts, train and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="safetensors file")
    parser.add_argument("--families", nargs="+", default=[name for name in FAMILIES if name not in HELD_OUT])
    parser.add_argument("--parts", type=int, default=960)
    parser.add_argument("--held-out", type=int, default=128, help="parts of other families that show the progress")
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--batch", type=int, default=PARTS, help="parts per step")
    parser.add_argument("--dimensions", type=int, default=128)
    parser.add_argument("--place-weight", type=float, default=0.5, help="weight of the nearest places in the loss")
    parser.add_argument("--kept", type=Path, help="file that keeps the parts for the next run")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--meshes", type=Path, default=Path("training-parts"), help="folder for the meshes")
    arguments = parser.parse_args()
    start = time.monotonic()
    if arguments.kept is None or not arguments.kept.exists():
        sets = make_parts(arguments)
        if arguments.kept is not None:
            torch.save(sets, arguments.kept)
    else:
        sets = torch.load(arguments.kept)
    print(f"{len(sets[0]['keys'])} keys, made in {time.monotonic() - start:.0f} s", flush=True)
    device = torch.device(arguments.device)
    held = Data(sets[1], device) if len(sets) > 1 else None
    model = train(Data(sets[0], device), held, arguments)
    weights = {**model.keys.export("keys"), **model.queries.export("queries")}
    weights["temperature"] = model.temperature.detach().float().cpu().reshape(1)
    save_file(weights, arguments.out)
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.2f} MB, {time.monotonic() - start:.0f} s in all")


if __name__ == "__main__":
    main()
