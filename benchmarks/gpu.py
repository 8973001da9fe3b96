#!/usr/bin/env python3
"""The learned encoder on a GPU: times of a training epoch, and of encoding and matching a touch.

An epoch of `--preset`, on a grid of about `--poses` poses of a demo object, renders touches, takes the training steps,
and encodes the keys. Encoding starts with contact depths in the memory of `--device`, and ends with the scores of
20 000 keys in this memory. Times are medians in one run, for one touch and for 256, in float32, in bfloat16, and as a
CUDA graph. `--device cpu` runs the same without graphs, as a rehearsal.
"""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from single_touch import choose_spacing
from torch import nn

from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.locate.localizer import Localizer
from tactile_loc.plugins.encoders.moco.backbones import make_backbone
from tactile_loc.plugins.encoders.moco.recipe import PRESETS, Recipe
from tactile_loc.plugins.encoders.moco.training import Trainer
from tactile_loc.simulate.listed_training import ListedProblem
from tactile_loc.store.store import StageStore

BATCHES = (1, 256)


def make_network(recipe: Recipe) -> nn.Module:
    """Return the recipe's network, untrained, because training does not change its speed."""
    generator = torch.Generator().manual_seed(0)
    return make_backbone(
        recipe.backbone,
        generator=generator,
        in_channels=recipe.planes(partly_seen=False),
        channels=recipe.channels,
        norm=recipe.norm,
    )


def time_epochs(recipe: Recipe, arguments: argparse.Namespace, device: torch.device) -> dict[str, float]:
    """Train two epochs. Return the seconds of the second epoch, in all and by part."""
    obj = load_object(arguments.object)
    settings = {"sensor": "gelslim", "shape_px": recipe.image_px}
    grid = {"name": "face", "spacing_mm": choose_spacing(obj, settings, arguments.poses)}
    with tempfile.TemporaryDirectory() as store:
        localizer = Localizer.create(arguments.object, store=StageStore(Path(store)), grid=grid, **settings)
        model = localizer.model
        problem = ListedProblem(model.grid, localizer.coarse_scene, localizer.sampler, model.shapes.shards)
        trainer = Trainer(recipe, problem, make_network(recipe), device)
        rendered = trainer.source.epochs(0, 2)
        trainer._train_epoch(next(rendered))
        start = time.perf_counter()
        queries = next(rendered)
        waited = time.perf_counter() - start
        trainer._train_epoch(queries)
        _finish(device)
        whole = time.perf_counter() - start
        start = time.perf_counter()
        trainer._keys(trainer.key_network, float(problem.key_presses_m[-1]))
        _finish(device)
        return {
            "poses": model.size,
            "queries": recipe.queries,
            "epoch_s": whole,
            "keys_s": time.perf_counter() - start,
            "waiting_for_renders_s": waited,
        }


def time_latencies(recipe: Recipe, keys: int, device: torch.device, rounds: int) -> dict[str, float]:
    """Return the median time, ms, from the network's input to the scores of `keys` keys, for each computation."""
    found: dict[str, float] = {}
    for dtype in (torch.float32, torch.bfloat16):
        network = make_network(recipe).to(device, dtype).eval().to(memory_format=torch.channels_last)
        for batch in BATCHES:
            with torch.inference_mode():
                locate = time_matching(network, recipe, batch, keys)
                name = f"{str(dtype).removeprefix('torch.')}, {batch}"
                found[name] = time_median(locate, device, rounds)
                if device.type == "cuda":
                    found[f"{name}, CUDA graph"] = time_median(capture_graph(locate), device, rounds)
    return found


def time_matching(network: nn.Module, recipe: Recipe, batch: int, keys: int) -> Callable[[], torch.Tensor]:
    """Return a function that encodes a batch of touches and scores `keys` keys."""
    weight = next(network.parameters())
    images = torch.rand(batch, recipe.planes(partly_seen=False), recipe.image_px, recipe.image_px, device=weight.device)
    images = images.to(weight.dtype).to(memory_format=torch.channels_last)
    floats = network(images[:1]).flatten(1).shape[1]
    bank = torch.randn(keys, floats, device=weight.device, dtype=weight.dtype)
    return lambda: nn.functional.normalize(network(images).flatten(1), dim=1) @ bank.T


def capture_graph(work: Callable[[], Any]) -> Callable[[], Any]:
    """Record work as a CUDA graph, and return a function that replays it."""
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for _ in range(3):
            work()
    torch.cuda.current_stream().wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        work()
    return graph.replay


def time_median(work: Callable[[], Any], device: torch.device, rounds: int) -> float:
    """Return the median duration of a function, ms. Each measurement waits until the device has finished."""
    for _ in range(3):
        work()
    seconds = []
    for _ in range(rounds):
        _finish(device)
        start = time.perf_counter()
        work()
        _finish(device)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)) * 1e3


def _finish(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize()


def main() -> None:
    """Run the benchmark, and print the results as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="pin", help="demo object or mesh file")
    parser.add_argument("--preset", default="paper", choices=sorted(PRESETS))
    parser.add_argument("--poses", type=int, default=20_000, help="approximate poses of the grid")
    parser.add_argument("--queries", type=int, help="touches in each epoch; default: the preset's")
    parser.add_argument("--keys", type=int, default=20_000, help="keys to match a touch with")
    parser.add_argument("--rounds", type=int, default=100)
    parser.add_argument("--device", default="cuda", choices=("cuda", "cpu"))
    arguments = parser.parse_args()
    if arguments.device == "cuda" and not torch.cuda.is_available():
        parser.error("torch sees no CUDA device here; rehearse with --device cpu")
    device = torch.device(arguments.device)
    recipe = replace(PRESETS[arguments.preset], **({"queries": arguments.queries} if arguments.queries else {}))
    chip = torch.cuda.get_device_name() if device.type == "cuda" else platform.processor() or "CPU"
    print(json.dumps({"chip": chip, "torch": torch.__version__, "recipe": asdict(recipe)}, indent=1), flush=True)
    print(json.dumps({"latency_ms": time_latencies(recipe, arguments.keys, device, arguments.rounds)}, indent=1))
    print(json.dumps({"training": time_epochs(recipe, arguments, device)}, indent=1))


if __name__ == "__main__":
    main()
