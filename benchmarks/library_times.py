#!/usr/bin/env python3
"""Time and memory of identifying among the parts of a library on disk.

Parts are pressed from random directions. The table has medians over the touched parts, for one touch, the first two,
and so on. The votes of all parts are joined, or only those that decide: see `Shortlist`. The scan is the pass through
all vectors, which gives the bounds of the votes. Each example is identified twice. The first time, few of its likely
parts are open; the second time, all are.

Times are those of all processors together, s, because a shared machine delays a program. The memory is that of the
process without mapped files. `--no-identify` leaves out the identification.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from identify import choose_asked, draw_example, open_search
from tactile_loc_library.identification import choose_shortlists, identify_part
from tactile_loc_library.search import PartSearch
from tactile_loc_library.votes import rate_object

from tactile_loc import TactileLocError, Touch

COLUMNS = ("parts", "touches", "examples", "all votes", "deciding votes", "of these the scan", "joined")
IDENTIFIED = ("first identified", "again")


def measure(function: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """Return the processor time of a call, s, and its result."""
    start_s = time.process_time()
    result = function(*arguments)
    return time.process_time() - start_s, result


def measure_example(search: PartSearch, touches: list[Touch], identifies: bool) -> list[float]:
    """Return the times, s, and the number of joined parts, in the order of the columns."""
    all_s, _ = measure(search.compare, touches)
    with patch("tactile_loc_library.search.rate_object", wraps=rate_object) as rated:
        some_s, votes = measure(search.compare, touches, choose_shortlists(len(touches), len(search))[0])
    scan_s, _ = measure(search.find_most_similar, votes.described.rounded, lambda count: None)
    whole = [measure(identify_part, touches, search)[0] for _ in range(2)] if identifies else []
    return [all_s, some_s, scan_s, rated.call_count, *whole]


def read_own_memory() -> float:
    """Return the memory of this process without mapped files, GB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (used,) = (line.split()[1] for line in lines if line.startswith("RssAnon"))
    return int(used) * 1024 / 1e9


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("library", type=Path)
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--asked", default="", help="regular expression for the names of touched parts")
    parser.add_argument("--most", type=int, help="number of touched parts; default: all")
    parser.add_argument("--level", default="clean", choices=["clean", "mild"])
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--no-identify", dest="identifies", action="store_false")
    parser.add_argument("--seed", type=int, default=47)
    parser.add_argument("--store", type=Path, help="store of models")
    arguments = parser.parse_args()
    search = open_search(arguments)
    rows: dict[int, list[list[float]]] = {count: [] for count in arguments.touches}
    for name in choose_asked(search, arguments.asked, arguments.most):
        try:
            touches = draw_example(search, search.names.index(name), arguments, 0)
        except TactileLocError as error:
            print(f"  {name} is left out: {error}", flush=True)
            continue
        for count, row in rows.items():
            row.append(measure_example(search, touches[:count], arguments.identifies))
    columns = [*COLUMNS, *(IDENTIFIED if arguments.identifies else ())]
    print(f"| {' | '.join(columns)} |")
    print("|---" * len(columns) + "|")
    for count, row in rows.items():
        every, some, scan, joined, *whole = np.median(row[1:] or row, axis=0)  # the first one loads the compiled code
        spent = " | ".join(f"{one:.2f}" for one in (every, some, scan))
        last = "".join(f" {one:.1f} |" for one in whole)
        print(f"| {len(search)} | {count} | {len(row)} | {spent} | {joined:.0f} |{last}")
    mapped = sum(shard.vectors.nbytes + shard.placements.nbytes for shard in search.library.shards)
    print(f"memory {read_own_memory():.2f} GB, mapped arrays {mapped / 1e9:.2f} GB", flush=True)


if __name__ == "__main__":
    main()
