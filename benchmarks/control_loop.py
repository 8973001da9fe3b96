#!/usr/bin/env python3
"""Times of the calls of a control loop with two fingers, after `Localizer.prepare`.

The first row of an object is the script of docs/control-loop.md, which tracks at 50 Hz. The other rows call the
localizer with touches of the script, one finger or both.
"""

import argparse
import contextlib
import io
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc import Localizer, Touch

PAGE = Path(__file__).parents[1] / "docs" / "control-loop.md"
BLOCK = re.compile(r"^```python\n(import time.*?)^```$", re.MULTILINE | re.DOTALL)


def run_script(name: str) -> dict[str, Any]:
    """Run the script of the page with a demo object of this name, and return its variables."""
    (script,) = BLOCK.findall(PAGE.read_text())
    variables: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(script.replace('"hook"', repr(name)), str(PAGE), "exec"), variables)
    return variables


def time_calls(call: Callable[[Any], object], given: Sequence[Any]) -> list[float]:
    """Return the seconds of a call with each of the arguments."""
    seconds = []
    for argument in given:
        start = time.perf_counter()
        call(argument)
        seconds.append(time.perf_counter() - start)
    return seconds


def find_touches(fingers: Sequence[Localizer], images: Sequence[Any]) -> list[Touch | None]:
    """Return the touch of each finger, from its image and the pose of its sensor."""
    return [finger.find_touch(*image) for finger, image in zip(fingers, images, strict=True)]


def write_row(name: str, what: str, seconds: list[float]) -> str:
    """Return a row of the table."""
    p50, p95, longest = 1e3 * np.quantile(seconds, [0.5, 0.95, 1.0])
    return f"| {name} | {what} | {len(seconds)} | {p50:.1f} | {p95:.1f} | {longest:.1f} |"


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("objects", nargs="*", default=["pin", "hook"])
    parser.add_argument("--calls", type=int, default=30)
    asked = parser.parse_args()
    print("| object | call | calls | p50, ms | p95, ms | longest, ms |\n|---|---|---|---|---|---|")
    for name in asked.objects:
        script = run_script(name)
        localizer, fingers, read = script["localizer"], script["fingers"], script["read_finger"]
        images = [[read(number, 0.07 * k) for number in range(2)] for k in range(asked.calls)]  # no finger opens
        print(write_row(name, "`find_touch`, `tracker.update`, two fingers", script["seconds"]), flush=True)
        for count, what in ((1, "one finger"), (2, "two fingers")):
            for call in (localizer.find_most_probable_pose, localizer.locate):
                # new touches for each call, because what was matched is kept for each touch
                given = [find_touches(fingers, pair)[:count] for pair in images]
                seconds = time_calls(call, given)
                print(write_row(name, f"`{call.__name__}`, {what}", seconds), flush=True)


if __name__ == "__main__":
    main()
