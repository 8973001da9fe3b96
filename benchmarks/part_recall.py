#!/usr/bin/env python3
"""How many parts of a library explain touches better than the touched part does, at the first comparison of all parts.

Parts of a library on disk are pressed from random directions, by 30 to 90 % of the sensor's deepest press. The touches
are drawn by ray casting. All parts are rated by the joined votes of the first touch, the first two, and so on.

The rank of a part is the number of better parts. The table has the mean rank as a share of the parts, the share of
examples in which the touched part is among the best 64, and in which it is the best. For a smaller library, the other
parts are a random choice. `--asked` chooses the touched parts by their names.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from identify import SUFFERING, choose_asked, make_source
from numpy.typing import NDArray
from tactile_loc_library.library import Library
from tactile_loc_library.search import PartSearch

from tactile_loc import RunConfig, TactileLocError

SHORTLIST = 64


def rate(search: PartSearch, k: int, level: str, most: int, seed: int) -> NDArray[np.float64]:
    """Return the log-likelihoods (most, K) of all K parts, given the first touches of part k, 1 to `most`."""
    rng = np.random.default_rng([seed, *map(ord, search.names[k])])
    with search.use(k) as part:
        touches = make_source(part.model, level).draw_example(most, rng)[0]
    return np.stack([search.compare(touches[: n + 1]).nats for n in range(most)])


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("library", type=Path)
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--asked", default="", help="regular expression for the names of touched parts")
    parser.add_argument("--most", type=int, help="number of touched parts; default: all")
    parser.add_argument("--levels", nargs="+", default=["clean", "mild"], choices=sorted(SUFFERING))
    parser.add_argument("--touches", type=int, default=3)
    parser.add_argument("--sizes", nargs="+", type=int, default=[100, 300])
    parser.add_argument("--seed", type=int, default=41)
    arguments = parser.parse_args()
    search = PartSearch(Library.open(arguments.library), RunConfig.from_dict({"sensor": arguments.sensor}))
    asked = [search.names.index(name) for name in choose_asked(search, arguments.asked, arguments.most)]
    rng = np.random.default_rng(arguments.seed)
    print(
        "| touches | noise | parts | examples | mean rank, share of the parts | among the best 64 | best | ms a part |"
    )
    print("|---" * 8 + "|")
    for level in arguments.levels:
        rated, seconds = {}, 0.0
        for k in asked:
            start = time.perf_counter()
            try:
                rated[k] = rate(search, k, level, arguments.touches, arguments.seed)
            except TactileLocError as error:
                print(f"  {search.names[k]} is left out: {error}", flush=True)
            seconds += time.perf_counter() - start
        for size in (n for n in arguments.sizes if n <= len(search)):
            for n in range(arguments.touches):
                ranks = np.array([_rank(nats[n], k, size, rng) for k, nats in rated.items()])
                spent_ms = 1e3 * seconds / (len(rated) * len(search) * arguments.touches)
                print(
                    f"| {n + 1} | {level} | {size} | {len(ranks)} | {ranks.mean() / size:.1%} "
                    f"| {(ranks < SHORTLIST).mean():.0%} | {(ranks == 0).mean():.0%} | {spent_ms:.1f} |",
                    flush=True,
                )


def _rank(nats: NDArray[np.float64], k: int, size: int, rng: np.random.Generator) -> int:
    """Return how many of `size` - 1 other parts are likelier than part k."""
    others = rng.permutation(np.delete(nats, k))[: size - 1]
    return int((others > nats[k]).sum())


if __name__ == "__main__":
    main()
