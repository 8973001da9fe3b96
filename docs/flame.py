#!/usr/bin/env python3
"""Draw where the time of locating goes: a flame graph of many calls, in one thread.

py-spy takes samples of a process that locates simulated touches again and again (`pip install py-spy`). The width of a
function is its share of the samples. The functions that it calls are above it. Only functions of this project are
drawn, so compiled code and numpy count for the function that calls them.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
RATE = 400  # samples per second
FIRST = "localize_together"  # the function at the bottom
LEAST = 0.004  # narrower functions are not drawn, as a share of the whole
LABELLED = 0.03  # narrower functions have no name
COLOURS = {"match": "#4c78a8", "register": "#f58518", "refine": "#54a24b", "choose": "#b279a2", "": "#bab0ac"}
STAGES = {  # functions that belong to a stage, with all that they call
    "propose": "match", "_keep_nearest": "match", "_register_group": "register", "_register": "register",
    "compute_imprint_ious": "register", "refine": "refine", "_compare": "choose", "merge_hypotheses": "choose",
}  # fmt: skip


def locate(name: str, touches: int, seconds: float) -> None:
    """Locate simulated touches of an object for some time, after everything is loaded."""
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.locate.several_touches import localize_together

    localizer = Localizer.create(name)
    examples = [localizer.simulate_together(touches, seed=seed) for seed in range(20)]
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        for example in examples:
            localize_together([(localizer, touch) for touch in example])


def record(name: str, touches: int, seconds: float) -> Counter[tuple[str, ...]]:
    """Return how often each stack of the project's functions was seen, from FIRST on."""
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    with tempfile.TemporaryDirectory() as folder:
        stacks = Path(folder) / "stacks.txt"
        command = ["py-spy", "record", "--rate", str(RATE), "--format", "raw", "--output", str(stacks), "--"]
        command += [sys.executable, __file__, name, "--touches", str(touches), "--seconds", str(seconds), "--locate"]
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return read_stacks(stacks.read_text())


def read_stacks(text: str) -> Counter[tuple[str, ...]]:
    """Read py-spy's lines: frames such as `name (path:line)`, joined by semicolons, and a count."""
    seen: Counter[tuple[str, ...]] = Counter()
    for line in text.splitlines():
        frames, _, count = line.rpartition(" ")
        names = [frame.partition(" (")[0] for frame in frames.split(";") if "tactile_loc/" in frame]
        if FIRST in names:
            seen[tuple(names[names.index(FIRST) :])] += int(count)
    return seen


def draw(seen: Counter[tuple[str, ...]], path: Path, title: str) -> None:
    """Draw the stacks as a flame graph."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    total = sum(seen.values())
    deepest = max(map(len, seen))
    figure, axes = plt.subplots(figsize=(12, 0.32 * deepest + 0.6))

    def draw_above(stacks: Counter[tuple[str, ...]], left: float, level: int, stage: str) -> None:
        groups: dict[str, Counter[tuple[str, ...]]] = {}
        for names, count in stacks.items():
            if len(names) > level:
                groups.setdefault(names[level], Counter())[names] += count
        for name, some in sorted(groups.items(), key=lambda item: -sum(item[1].values())):
            width = sum(some.values()) / total
            own = stage or STAGES.get(name.rpartition(".")[2], "")
            if width >= LEAST:
                axes.barh(level, width, 0.94, left, color=COLOURS[own], edgecolor="white", linewidth=0.6)
            if width >= LABELLED:
                text = axes.text(left + 0.003, level, name, va="center", fontsize=7, clip_on=True)
                text.set_clip_path(axes.patches[-1])
            draw_above(some, left, level + 1, own)
            left += width

    draw_above(seen, 0.0, 0, "")
    axes.set(xlim=(0, 1), ylim=(-0.5, deepest - 0.5), yticks=[], xlabel="share of the time")
    axes.xaxis.set_major_formatter(mpl.ticker.PercentFormatter(1.0))
    for name, colour in COLOURS.items():
        axes.barh(-9, 0, color=colour, label=name or "other")
    axes.legend(loc="upper right", fontsize=8, frameon=False)
    axes.set_title(title, fontsize=10, loc="left")
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    figure.tight_layout()
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    """Record and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("object", nargs="?", default="hook", help="a mesh file or a demo object's name")
    parser.add_argument("--touches", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "flame.png")
    parser.add_argument("--locate", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.locate:
        locate(arguments.object, arguments.touches, arguments.seconds)
        return
    touches = f"{arguments.touches} touches" if arguments.touches > 1 else "one touch"
    seen = record(arguments.object, arguments.touches, arguments.seconds)
    draw(seen, arguments.out, f"{touches} of {Path(arguments.object).stem}, {sum(seen.values())} samples, one thread")


if __name__ == "__main__":
    main()
