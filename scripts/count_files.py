#!/usr/bin/env python3
"""Count the files of tactile_loc whose functions a second, warm `localize` of one touch enters."""

import argparse
import sys
import tempfile
import threading
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

import tactile_loc
from tactile_loc import Localizer
from tactile_loc.core.sensing.touch import Touch

ROOT = Path(tactile_loc.__file__).parent


def count_calls(localizer: Localizer, touch: Touch) -> Counter[str]:
    """Return the number of calls to functions of each file while the touch is located."""
    calls: Counter[str] = Counter()

    def record(frame: FrameType, event: str, argument: Any) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(ROOT):
            calls[str(path.relative_to(ROOT))] += 1

    threading.setprofile(record)
    sys.setprofile(record)
    localizer.localize(touch)
    sys.setprofile(None)
    threading.setprofile(None)
    return calls


def main() -> None:
    """Print the files and their calls: of the same touch again, and of another touch."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("object", nargs="?", default="hook")
    with tempfile.TemporaryDirectory() as store:
        localizer = Localizer.create(parser.parse_args().object, temperature=0.02, store=store)
        first, other = localizer.simulate(2)
        localizer.localize(first)
        again, new = count_calls(localizer, first), count_calls(localizer, other)
    print(f"{len(again)} files for the same touch, {len(new)} for another touch")
    for package in sorted({name.split("/")[0] for name in new}):
        print(f"{package}: {sum(name.startswith(f'{package}/') for name in again)}")
    for name in sorted(new):
        print(f"{again[name]:6} {new[name]:6}  {name}")


if __name__ == "__main__":
    main()
