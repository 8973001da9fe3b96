#!/usr/bin/env python3
"""The learned encoder on a GPU: its training on one object, its errors, and the times of encoding and matching.

The encoder of `--preset` is trained on the face grid of a demo object. Then `pixel`, the preset `cpu` and the trained
encoder locate the same `--touches` with strong noise, by the protocol of `tactile-loc paper`. The command resumes with
the same `--store`.

Encoding starts with contact depths in the memory of `--device`, and ends with the scores of 20 000 keys in this memory.
Times are medians in one run, for one touch and for 256, in float32, in bfloat16, and as a CUDA graph. `--device cpu`
runs the same without graphs, as a rehearsal.
"""

import argparse
import json
import logging
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from tactile_loc.evaluation.paper.tables import PAPER_LINES
from tactile_loc.evaluation.protocol import evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.summary import find_scale_m, summarise_lines
from tactile_loc.locate.localizer import Localizer
from tactile_loc.plugins.encoders.moco.backbones import make_backbone
from tactile_loc.plugins.encoders.moco.recipe import PRESETS, Recipe

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


def measure_encoders(recipe: Recipe, arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Train the encoders, and yield the times and the normalised errors of each."""
    own = {"preset": arguments.preset, "epochs": recipe.epochs, "queries": recipe.queries, "device": arguments.device}
    encoders = {arguments.preset: own, "cpu": {"preset": "cpu", "device": arguments.device}, "pixel": {}}
    encoders = {name: encoders[name] for name in arguments.encoders or encoders}
    touches = SimulatedTouches("strong", arguments.seed)
    for label, options in encoders.items():
        localizer = Localizer.create(
            arguments.object,
            store=arguments.store,
            sensor="gelslim",
            shape_px=recipe.image_px,
            grid={"name": "face", "spacing_mm": arguments.spacing_mm},
            encoder={"name": "moco" if options else "pixel", **options},
        )
        start = time.perf_counter()
        localizer.listed.matcher(localizer.scene.geometry.max_depth_m)
        trained_s = time.perf_counter() - start
        table = evaluate(localizer, arguments.touches, touches)
        rows = summarise_lines(table, PAPER_LINES)
        yield {
            "encoder": label,
            "options": options,
            "poses": localizer.model.size,
            "prepared_s": trained_s,
            "located_s": time.perf_counter() - start - trained_s,
            "random_mm": find_scale_m(table) * 1e3,
            "normalised": {row["line"]: row["median_normalised"] for row in rows},
            "median_mm": {row["line"]: row["median_m"] * 1e3 for row in rows},
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
    parser.add_argument("--object", default="elbow_pipe", help="demo object or mesh file")
    parser.add_argument("--preset", default="paper", choices=sorted(PRESETS))
    parser.add_argument("--encoders", nargs="+", help="only these: a preset, or pixel")
    parser.add_argument("--spacing-mm", type=float, default=4.0, help="spacing of the grid's poses, mm")
    parser.add_argument("--epochs", type=int, help="default: the preset's")
    parser.add_argument("--queries", type=int, help="touches in each epoch; default: the preset's")
    parser.add_argument("--touches", type=int, default=60, help="touches to locate with each encoder")
    parser.add_argument("--seed", type=int, default=1, help="seed of these touches")
    parser.add_argument("--keys", type=int, default=20_000, help="keys to match a touch with, for the times")
    parser.add_argument("--rounds", type=int, default=100, help="rounds of the times")
    parser.add_argument("--store", type=Path, help="folder of built models; default: the usual store")
    parser.add_argument("--device", default="cuda", choices=("cuda", "cpu"))
    arguments = parser.parse_args()
    if arguments.device == "cuda" and not torch.cuda.is_available():
        parser.error("torch sees no CUDA device here; rehearse with --device cpu")
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    device = torch.device(arguments.device)
    given = {name: getattr(arguments, name) for name in ("epochs", "queries") if getattr(arguments, name)}
    recipe = replace(PRESETS[arguments.preset], **given)
    chip = torch.cuda.get_device_name() if device.type == "cuda" else platform.processor() or "CPU"
    print(json.dumps({"chip": chip, "torch": torch.__version__, "recipe": asdict(recipe)}), flush=True)
    print(json.dumps({"latency_ms": time_latencies(recipe, arguments.keys, device, arguments.rounds)}), flush=True)
    for row in measure_encoders(recipe, arguments):
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
