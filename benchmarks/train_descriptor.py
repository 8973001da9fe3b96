#!/usr/bin/env python3
"""Train the descriptor of contacts on generated parts, and write its weights as a safetensors file.

Each part has keys, which are the patches of its places, and queries, which are patches of the same part in other
directions. A query is shown as a touch: in a rotated gel that sees only a part of it, pressed by 0.2 to 1.2 mm, with
noise, and sometimes with a blurred surface, as an elastic gel has. The networks learn to give a query a high similarity
to the keys of its own part, and the highest to the keys nearest to it (Oord et al., 2018: InfoNCE).

With `--start`, the network of places of other weights is kept, so that libraries stay valid. Only the network of
touches is trained further. Its keys are vectors that are computed once, so a step takes about a second on two cores.

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
from generated_parts import FAMILIES, ROUNDED, list_names, make_mesh
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from tactile_loc_library.descriptor import ANGLES, RADII_M, RAMPS_M, STEPS
from tactile_loc_library.descriptor import Descriptor as Described
from torch import Tensor, nn
from torch.nn import functional

from tactile_loc import ObjectModel, load_object
from tactile_loc.core.places.places import BELOW, PATCH_PX, PITCH_M, STEP_M, Places
from tactile_loc.core.sensing.noise import FAINTEST, NOISE
from tactile_loc.plugin import Progress, registry

HELD_OUT = ("gear", "clip", "fitting", "cam")
TRAINED = [*(name for name in FAMILIES if name not in HELD_OUT), *ROUNDED]
KEY_DIRECTIONS, QUERY_DIRECTIONS = 800, 331
MOST_QUERIES, NEAREST = 400, 4
NEAR = 64  # keys near a query, of which the nearest ones depend on where it is touched
LEVER_M = 0.01  # a rotation by an angle counts as this distance times the angle
PARTS, QUERIES, KEYS = 384, 2, 48  # per step: parts, queries of each part, and keys of each part
EPS = 1e-12
ELASTIC, NOISY = 0.25, 0.6  # shares of the touches
WARM_UP = 50  # steps
STRONG = NOISE["strong"]  # the noise of a strength of 1
MOST_MISSING = 2  # discs of missed contact
FARTHEST_ANCHOR_M = 5e-3


class Part(NamedTuple):
    """The K places and Q queries of a part.

    `keys` are the places' patches (K, S, S), or their vectors (K, D) if these do not change. `queries` (Q, S, S) are
    patches, with their `axes` (Q, 2, 3): the directions of their columns and rows in the object frame. `nearest`
    (Q, NEAR) are the numbers of the nearest keys, the farthest one repeated if there are fewer than NEAR. `off`
    (Q, NEAR, 4) are how far away they are: the difference of the positions, metres, and the angle of the directions, as
    a length.
    """

    keys: NDArray[np.uint8] | NDArray[np.int8]
    queries: NDArray[np.uint8]
    axes: NDArray[np.float32]
    nearest: NDArray[np.int64]
    off: NDArray[np.float32]


def find_places(obj: ObjectModel, directions: int) -> Places:
    """Return the places of an object for a number of directions."""
    return registry().create("grid", "whole", {"directions": directions}).places(obj, Progress())


def make_training_part(name: str, folder: Path, places: Described | None) -> Part:
    """Return the keys and queries of a generated part. With a descriptor, the keys are vectors."""
    path = folder / f"{name}.stl"
    make_mesh(name).export(path)
    obj = load_object(str(path), units="mm")
    keys, queries = find_places(obj, KEY_DIRECTIONS), find_places(obj, QUERY_DIRECTIONS)
    rng = np.random.default_rng(len(keys))
    some = np.sort(rng.permutation(len(queries))[:MOST_QUERIES])
    ours, theirs = queries.placements[some], keys.placements
    off_m = theirs[None, :, :3] - ours[:, None, :3]
    turned_m = LEVER_M * np.arccos(np.clip(ours[:, 3:] @ theirs[:, 3:].T, -1, 1))
    off = np.concatenate([off_m, turned_m[:, :, None]], axis=2).astype(np.float32)
    nearest = np.argsort(np.linalg.norm(off_m, axis=2) + turned_m, axis=1)
    nearest = nearest[:, np.minimum(np.arange(NEAR), len(keys) - 1)]  # the farthest one is repeated
    return Part(
        keys.patches if places is None else places.describe_in_steps(keys.patches),
        queries.patches[some], queries.T_place_object[some, :2, :3].astype(np.float32), nearest,
        np.take_along_axis(off, nearest[:, :, None], axis=1),
    )  # fmt: skip


def _make_in_worker(task: tuple[str, Path, Path | None]) -> Part | None:
    name, folder, weights = task
    try:
        return make_training_part(name, folder, None if weights is None else Described(weights.read_bytes()))
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

    def adopt(self, weights: dict[str, Tensor], name: str, x: Tensor) -> None:
        """Continue from weights of `export`. The norms get the statistics of features (B, C, ANGLES)."""
        with torch.no_grad():
            for k, (layer, norm) in enumerate(zip(self.layers, self.norms, strict=True)):
                layer.weight.copy_(weights[f"{name}.{k}.weight"])
                x = layer(x)
                norm.running_mean.copy_(x.mean(dim=(0, 2)))
                norm.running_var.copy_(x.var(dim=(0, 2)))
                norm.weight.copy_(torch.sqrt(norm.running_var + norm.eps))
                norm.bias.copy_(norm.running_mean + weights[f"{name}.{k}.bias"])
                x = functional.relu(x + weights[f"{name}.{k}.bias"][:, None])
            self.out.weight.copy_(weights[f"{name}.out.weight"])
            self.out.bias.copy_(weights[f"{name}.out.bias"])

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

    def __init__(self, dimensions: int, temperature: float) -> None:
        super().__init__()
        rings, ramps = len(RADII_M), len(RAMPS_M)
        self.keys = Tower(rings * ramps, (96, 128, 160), dimensions)
        self.queries = Tower(2 * rings * ramps, (160, 224, 320), dimensions)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(temperature)))

    @property
    def temperature(self) -> Tensor:
        """The temperature of the similarities, unitless."""
        return self.log_temperature.exp().clamp(min=0.01)


def make_rings(yaw_rad: Tensor, at_m: Tensor) -> Tensor:
    """Return the points (B, rings, ANGLES, 2) of the rings about points (B, 2), metres, rotated by yaws (B,)."""
    device = at_m.device
    radius = torch.as_tensor(RADII_M, dtype=torch.float32, device=device)[None, :, None]
    angle = torch.arange(ANGLES, device=device) * (2 * math.pi / ANGLES)
    angle = angle[None, None, :] + yaw_rad[:, None, None]
    return torch.stack([radius * angle.cos(), radius * angle.sin()], dim=3) + at_m[:, None, None, :]


def sample(images: Tensor, points_m: Tensor) -> Tensor:
    """Sample images (B, S, S) at points (B, rings, ANGLES, 2), metres, from their middle."""
    grid = points_m / (PITCH_M * PATCH_PX / 2)
    return functional.grid_sample(images[:, None], grid, padding_mode="border", align_corners=False)[:, 0]


def to_heights(patches: Tensor) -> Tensor:
    """Convert patches (B, S, S) to heights, metres, up to the end of the longest ramp."""
    return ((patches.float() - BELOW) * STEP_M).clamp(0, RAMPS_M[-1])


def encode_ramps(height_m: Tensor) -> Tensor:
    """Return the heights (B, rings, ANGLES), metres, on each ramp (B, ramps * rings, ANGLES), 0 to 1."""
    return torch.cat([(height_m / ramp).clamp(max=1) for ramp in RAMPS_M], dim=1)


def show_as_touch(patches: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return features (B, C, ANGLES) of patches (B, S, S) as a gel shows them, and where they are touched (B, 2).

    A touch is described about its deepest point. Noise and flat surfaces move this point from the middle of the patch.
    Positions are in metres, along the patch's columns and rows.
    """
    count = len(patches)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(count, *shape, generator=generator, device=patches.device)

    height_m = sag(((patches.float() - BELOW) * STEP_M).clamp(min=0), uniform(0, 1) < ELASTIC)
    press_m = 1e-3 * torch.exp(uniform(math.log(0.2), math.log(1.2)))
    strength = uniform(0, 1) * (uniform(0, 1) < NOISY)
    gel = Gel.draw(count, patches.device, generator)
    y, x = gel.list_pixels()
    depth_m, measured_m = add_noise(height_m, press_m, strength, gel, generator)
    contact = (depth_m < measured_m[:, None, None]) & gel.sees(x, y) & (x.hypot(y) < FARTHEST_ANCHOR_M)
    order = torch.where(contact, depth_m + 1e-6 * uniform(0, 1, PATCH_PX, PATCH_PX), torch.inf).flatten(1)
    deepest = torch.where(contact.flatten(1).any(dim=1), order.argmin(dim=1), PATCH_PX * PATCH_PX // 2)
    at_m = torch.stack([x.flatten()[deepest], y.flatten()[deepest]], dim=1)
    at_m = at_m + (strength > 0)[:, None] * PITCH_M * uniform(-0.5, 0.5, 2)
    polar = make_rings(uniform(0, 2 * math.pi), at_m)
    seen = gel.sees(polar[..., 0], polar[..., 1]) & (polar.abs().amax(dim=3) < PITCH_M * PATCH_PX / 2)
    return encode_seen_ramps(sample(depth_m, polar), seen, measured_m), at_m


def encode_seen_ramps(polar_m: Tensor, seen: Tensor, press_m: Tensor) -> Tensor:
    """Return the features (B, C, ANGLES) of polar depths, and which are known; see `features.encode_touch`."""
    press = press_m[:, None, None]
    touched = polar_m < press
    values = [(polar_m / ramp).clamp(max=1) * seen for ramp in RAMPS_M]
    known = [(seen & (touched | (press >= ramp))).to(polar_m.dtype) for ramp in RAMPS_M]
    return torch.cat(values + known, dim=1)


class Gel(NamedTuple):
    """B rectangular gels. `middle` (B, 2) and `half` (B, 2), metres, are in axes rotated by `angle` (B,)."""

    angle: Tensor
    middle: Tensor
    half: Tensor

    @classmethod
    def draw(cls, count: int, device: torch.device, generator: torch.Generator) -> Gel:
        """Draw gels of random sizes that see the middle of a patch."""

        def uniform(low: float, high: float) -> Tensor:
            return low + (high - low) * torch.rand(count, generator=generator, device=device)

        size = 1e-3 * torch.stack([uniform(13, 24), uniform(11, 18)], dim=1)
        middle = size * torch.stack([uniform(-0.4, 0.4), uniform(-0.4, 0.4)], dim=1)
        return cls(uniform(0, 2 * math.pi), middle, size / 2)

    def list_pixels(self) -> tuple[Tensor, Tensor]:
        """Return the y and x (1, S, S), metres, of a patch's pixels."""
        at = (torch.arange(PATCH_PX, device=self.half.device) - PATCH_PX // 2) * PITCH_M
        y, x = torch.meshgrid(at, at, indexing="ij")
        return y[None], x[None]

    def turn(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return points (B, H, W), metres, from the middle of each gel and in its axes."""
        wide = (slice(None), None, None)
        cosine, sine = self.angle.cos()[wide], self.angle.sin()[wide]
        return cosine * x + sine * y - self.middle[:, 0][wide], cosine * y - sine * x - self.middle[:, 1][wide]

    def sees(self, x: Tensor, y: Tensor) -> Tensor:
        """Return whether each gel sees points (B, H, W), metres."""
        u, v = self.turn(x, y)
        return (u.abs() < self.half[:, 0, None, None]) & (v.abs() < self.half[:, 1, None, None])

    def mark_border(self, x: Tensor, y: Tensor, width_m: Tensor, right: Tensor) -> Tensor:
        """Return whether points (B, H, W), metres, are within `width_m` (B, 1, 1) of a side, or beyond it.

        `right` (B, 1, 1) chooses the side: all gels have random angles.
        """
        u, v = self.turn(x, y)
        return torch.where(right, self.half[:, 0, None, None] - u, self.half[:, 1, None, None] - v) < width_m


def sag(height_m: Tensor, elastic: Tensor) -> Tensor:
    """Return heights (B, S, S), metres, smoothed as by an elastic gel where `elastic` (B,)."""
    softness_m, sagged = 0.08e-3, height_m.clone()
    some = (-softness_m * torch.log(blur(torch.exp(-height_m[elastic] / softness_m), 1.2) + EPS)).clamp(max=3e-3)
    sagged[elastic] = some - some.amin(dim=(1, 2), keepdim=True)
    return sagged


def add_noise(
    height_m: Tensor, press_m: Tensor, strength: Tensor, gel: Gel, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Return noisy depths (B, S, S) of heights pressed by (B,), and measured presses (B,), metres.

    The kinds of noise are those of `TouchNoise`, with a `strength` (B,) from 0, none, to 1, about that of STRONG.
    """
    count, device = len(height_m), height_m.device

    def draw(*shape: int) -> Tensor:
        return torch.rand(count, *shape, generator=generator, device=device)

    wide = (slice(None), None, None)
    press, strength, noisy = press_m[wide], strength[wide], (strength > 0)[wide]
    imprint = (press - height_m).clamp(min=0)
    imprint = torch.lerp(imprint, blur(imprint, STRONG.smoothing_m / PITCH_M), strength)
    least = STRONG.least_m + STRONG.edge_m * strength * draw_field(count, STRONG.edge_patch_m, device, generator)
    contact = imprint > torch.where(noisy, least.clamp(min=FAINTEST * STRONG.least_m), 0)
    drift = STRONG.drift_m * strength * draw_field(count, STRONG.drift_patch_m, device, generator)
    depth = torch.where(contact, (press - imprint + drift).clamp(min=0).minimum(press * (1 - 1e-6)), press)
    y, x = gel.list_pixels()
    for _ in range(MOST_MISSING):
        pixel = (contact * draw(PATCH_PX, PATCH_PX)).flatten(1).argmax(dim=1, keepdim=True)
        radius = STRONG.patch_m * (0.4 + 0.6 * strength) * (0.3 + 0.7 * draw(1, 1))
        near = (x - x.flatten()[pixel][..., None]).hypot(y - y.flatten()[pixel][..., None]) < radius
        depth = torch.where(near & (draw(1, 1) < 0.6 * strength), press, depth)
    at = PITCH_M * PATCH_PX * (draw(2, 1, 1) - 0.5)
    radius = STRONG.patch_m * (0.4 + 0.6 * strength) * (0.2 + 0.5 * draw(1, 1))
    near = (x - at[:, 0]).hypot(y - at[:, 1]) < radius
    false = press * (0.5 + 0.4 * draw(1, 1))
    depth = torch.where(near & (draw(1, 1) < 0.6 * strength), depth.minimum(false), depth)
    depth = torch.where(gel.mark_border(x, y, STRONG.border_m * strength * draw(1, 1), draw(1, 1) < 0.5), press, depth)
    factor = 1 + STRONG.press_error * strength * torch.randn(count, 1, 1, generator=generator, device=device)
    measured = press * factor.clamp(min=0.5)
    return torch.where(depth < press.minimum(measured), depth, measured), measured[:, 0, 0]


def draw_field(count: int, patch_m: float, device: torch.device, generator: torch.Generator) -> Tensor:
    """Draw random images (count, S, S), smooth over `patch_m` metres, with the mean 0 and the variance 1, unitless."""
    step = patch_m / PITCH_M
    at = torch.arange(PATCH_PX, device=device)[:, None]
    lattice = torch.arange(-3 * step, PATCH_PX + 3 * step, step, device=device)[None]
    weights = functional.normalize(torch.exp(-0.5 * ((at - lattice) / step) ** 2), dim=1)
    white = torch.randn(count, lattice.shape[1], lattice.shape[1], generator=generator, device=device)
    return weights @ white @ weights.T


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
        self.keys, self.queries, self.axes, self.nearest, self.off = (joined[name].to(device) for name in Part._fields)
        self.key_count, self.query_count = (joined[name].to(device) for name in ("keys_count", "queries_count"))
        self.first_key = torch.cumsum(self.key_count, 0) - self.key_count
        self.first_query = torch.cumsum(self.query_count, 0) - self.query_count

    def __len__(self) -> int:
        return len(self.key_count)

    def find_nearest(self, queries: Tensor, at_m: Tensor) -> Tensor:
        """Return the numbers (B, NEAREST), within their part, of the keys nearest to points (B, 2) of queries (B,)."""
        moved = torch.einsum("bi,bij->bj", at_m, self.axes[queries])
        off = self.off[queries]
        far = (off[..., :3] - moved[:, None]).norm(dim=2) + off[..., 3]
        return self.nearest[queries].gather(1, far.topk(NEAREST, largest=False).indices)


def describe_keys(model: Descriptor, keys: Tensor, generator: torch.Generator) -> Tensor:
    """Return the vectors (N, D) of keys: patches (N, S, S) at random yaws, or vectors (N, D) times STEPS."""
    if keys.dtype == torch.int8:
        return keys.float() / STEPS
    turned = 2 * math.pi * torch.rand(len(keys), generator=generator, device=keys.device)
    heights = sample(to_heights(keys), make_rings(turned, turned.new_zeros(len(keys), 2)))
    vectors: Tensor = model.keys(encode_ramps(heights))
    return vectors


def compute_loss(
    model: Descriptor, data: Data, arguments: argparse.Namespace, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Return the loss of a batch, nats, and the share of queries whose own part is the most similar one."""
    device, count = data.keys.device, arguments.queries
    chosen = torch.randperm(len(data), generator=generator, device=device)[: arguments.batch]

    def pick(first: Tensor, counts: Tensor, some: int) -> Tensor:
        share = torch.rand(len(chosen), some, generator=generator, device=device)
        return first[chosen, None] + (share * counts[chosen, None]).long()

    queries = pick(data.first_query, data.query_count, count).flatten()
    features, at_m = show_as_touch(data.queries[queries], generator)
    near = data.find_nearest(queries, at_m).view(len(chosen), count * NEAREST) + data.first_key[chosen, None]
    keys = torch.cat([pick(data.first_key, data.key_count, arguments.keys), near], dim=1)
    weight = torch.ones(keys.shape, device=device)
    weight[:, : arguments.keys] = data.key_count[chosen, None] / arguments.keys
    with torch.autocast(device.type, torch.bfloat16):
        code = describe_keys(model, data.keys[keys.flatten()], generator)
        asked = model.queries(features)
    logits = (asked.float() / model.temperature) @ code.float().T + weight.flatten().log()
    logits = logits.view(len(queries), len(chosen), -1)
    own = torch.arange(len(queries), device=device) // count
    by_part = torch.logsumexp(logits, dim=2)
    which = torch.arange(len(queries), device=device)
    loss_part = (by_part.logsumexp(dim=1) - by_part[which, own]).mean()
    slot = arguments.keys + (which % count)[:, None] * NEAREST + torch.arange(NEAREST, device=device)[None]
    positive = torch.logsumexp(torch.gather(logits[which, own], 1, slot), dim=1)
    others = by_part.masked_fill(functional.one_hot(own, len(chosen)).bool(), -torch.inf).logsumexp(dim=1)
    loss_place = (torch.logaddexp(others, positive) - positive).mean()
    first = (by_part.argmax(dim=1) == own).float().mean()
    return loss_part + arguments.place_weight * loss_place, first


def train(data: Data, held: Data | None, arguments: argparse.Namespace) -> Descriptor:
    """Train for some minutes and return the model. The learning rate follows a cosine over this time."""
    device = data.keys.device
    torch.manual_seed(arguments.seed)
    generator = torch.Generator(device).manual_seed(arguments.seed)
    model = Descriptor(arguments.dimensions, arguments.temperature).to(device)
    if arguments.start is not None:
        some = data.queries[:: max(1, len(data.queries) // 1000)]
        model.queries.adopt(load_file(arguments.start, arguments.device), "queries", show_as_touch(some, generator)[0])
    trained = model.parameters() if arguments.start is None else [*model.queries.parameters(), model.log_temperature]
    optimiser = torch.optim.AdamW(trained, lr=arguments.rate, weight_decay=1e-3)
    start, step, shown = time.monotonic(), 0, 0.0
    while (share := (time.monotonic() - start) / (60 * arguments.minutes)) < 1:
        for group in optimiser.param_groups:
            group["lr"] = (
                arguments.rate * min(1.0, step / WARM_UP) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))
            )
        loss, first = compute_loss(model, data, arguments, generator)
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
                    tried = [compute_loss(model, held, arguments, generator) for _ in range(8)]
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
                tasks = [(name, arguments.meshes, arguments.start) for name in list_names(count, families)]
                parts = [part for part in pool.imap(_make_in_worker, tasks, chunksize=2) if part is not None]
                sets.append(join(parts))
    return sets


def main() -> None:
    """Make the parts, train and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="safetensors file")
    parser.add_argument("--families", nargs="+", default=TRAINED)
    parser.add_argument("--parts", type=int, default=1320)
    parser.add_argument("--held-out", type=int, default=128, help="parts of other families that show the progress")
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--batch", type=int, default=PARTS, help="parts per step")
    parser.add_argument("--queries", type=int, default=QUERIES, help="touches of each part per step")
    parser.add_argument("--keys", type=int, default=KEYS, help="keys of each part per step")
    parser.add_argument("--temperature", type=float, default=0.07, help="of the similarities, at the start")
    parser.add_argument("--rate", type=float, default=2e-3, help="greatest learning rate")
    parser.add_argument("--start", type=Path, help="weights to start from; only the touches' network is trained")
    parser.add_argument("--dimensions", type=int, default=128)
    parser.add_argument("--place-weight", type=float, default=0.5, help="weight of the nearest places in the loss")
    parser.add_argument("--kept", type=Path, help="file that keeps the parts for the next run with the same --start")
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
    if (sets[0]["keys"].dtype == torch.int8) != (arguments.start is not None):
        parser.error(f"{arguments.kept} was made with another choice of --start; name another file")
    print(f"{len(sets[0]['keys'])} keys, made in {time.monotonic() - start:.0f} s", flush=True)
    device = torch.device(arguments.device)
    held = Data(sets[1], device) if len(sets) > 1 else None
    model = train(Data(sets[0], device), held, arguments)
    weights = {"temperature": model.temperature.detach().float().cpu().reshape(1), **model.queries.export("queries")}
    weights = (model.keys.export("keys") if arguments.start is None else load_file(arguments.start)) | weights
    save_file(weights, arguments.out)
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.2f} MB, {time.monotonic() - start:.0f} s in all")


if __name__ == "__main__":
    main()
