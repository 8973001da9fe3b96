#!/usr/bin/env python3
"""How often touches identify their object among many, and reject a library without it.

Every object in turn, or each of those that `--asked` and `--most` choose, is pressed from random directions, by 30 to
90 % of the sensor's deepest press. The touches are drawn by ray casting, which the localizer does not use. They are
identified among all objects, and among all objects except the touched one.

For each number of touches, the table has shares of examples. The touched object is first in the quick comparison, first
in the full comparison, among the located objects, or the most probable object. It is inseparable from the most probable
object if it is nearly as probable: see `AS_PROBABLE`. The answer is right if the touched object is also more probable
than "none of these". If the touched object and the parts that resemble it are left out, the table has the share of
rejected examples, also at the threshold that rejects 5 % of the known objects. Both columns "certain" have the share of
examples with this verdict. Then confused objects are listed. The second table is for objects that are left out while a
part that resembles them remains. The third table compares the probabilities with the true shares; unknown objects have
the weight of their prior. For each size of the library, the times of a quick comparison and of two touches follow.

`--fit` prints the null evidence under which the examples are most probable. Objects are FILE[:UNITS] or demo names.
`--out` keeps the examples, one file for each object and number of touches, which are not measured again.
"""

import argparse
import json
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from asked import make_source, split_asked
from contacts import LEVELS
from generated_parts import list_likenesses
from numpy.typing import NDArray
from tactile_loc_library.building import build_library, list_meshes
from tactile_loc_library.identification import LOCATED, find_candidates, identify_part
from tactile_loc_library.library import Library
from tactile_loc_library.null_fit import KnownAnswer, fit_null_evidence
from tactile_loc_library.record import PlaceGrid
from tactile_loc_library.search import PartSearch

from tactile_loc import Localizer, NullEvidence, RobotTouches, RunConfig, StageStore, Touch
from tactile_loc.core.sensing.noise import NOISE, TouchNoise
from tactile_loc.locate.identify import find_floors, identify
from tactile_loc.locate.result.verdict import Outcome, Verdict
from tactile_loc.locate.result.verdict import judge as judge_pose
from tactile_loc.planning.identification_files import AS_PROBABLE

TEMPERATURE = 0.05  # not fitted, because objects are weighed by their evidence
FALSE_ALARMS = 0.05
# The touched object is in the library; left out with the parts that resemble it; or left out, but such a part remains.
SITUATIONS = KNOWN, UNKNOWN, LIKENESS = "known", "unknown", "likeness"
NONE = "none of these"
BINS = (0.05, 0.2, 0.5, 0.8, 0.95)  # of probabilities
SHARES = (
    "glanced", "looked_into", "located", "first", "inseparable", "right", "certain", "certain_right", "rejected",
    "rejected_at_5", "strange_certain",
)  # fmt: skip
LIKE_SHARES = ("like_rejected", "like_named", "like_certain")
SUFFERING = {**LEVELS, "mild": {"noise": TouchNoise(**{**NOISE["mild"].__dict__, "press_share": (1.0, 1.0)})}}


def open_search(arguments: argparse.Namespace) -> PartSearch:
    """Return the search of the library on disk, or of a library that is built there from the meshes."""
    config = RunConfig.from_dict({"sensor": arguments.sensor, "temperature": TEMPERATURE})
    if meshes := getattr(arguments, "meshes", ()):
        given = [split_asked(mesh) for mesh in meshes]
        sources = [one for path, units in given for one in list_meshes([path], units)]
        build_library(arguments.library, sources, PlaceGrid("whole", {}))
    return PartSearch(Library.open(arguments.library), config, StageStore(arguments.store))


def choose_asked(search: PartSearch, pattern: str, most: int | None) -> list[str]:
    """Return the names of the touched objects: at least `most` of those that match `pattern`, evenly spread."""
    asked = [name for name in search.names if re.match(pattern, name)]
    return asked[:: max(1, len(asked) // (most or len(asked)))]


def choose_among(search: PartSearch, name: str, size: int, rng: np.random.Generator) -> PartSearch:
    """Return a search of `size` parts: the part `name`, those that resemble it, and a random choice of the others."""
    some = [one for one in (name, *list_likenesses(name)) if one in search.names][:size]
    others = [one for one in search.names if one not in some]
    some += rng.choice(others, min(size - len(some), len(others)), replace=False).tolist()
    rows = {one: search.library.rows[one] for one in sorted(some)}
    return PartSearch(replace(search.library, rows=rows), search.config, search.store)


def suffer(model: Localizer, level: str) -> RobotTouches:
    """Return touches of a model's object with a level of SUFFERING, drawn by another renderer than the model's."""
    return make_source(model.object, model.scene.geometry, **SUFFERING[level])


def draw_example(search: PartSearch, number: int, arguments: argparse.Namespace, again: int) -> list[Touch]:
    """Return the touches of one object. Examples with fewer touches use the first of these touches."""
    rng = np.random.default_rng([arguments.seed, *map(ord, search.names[number]), again])
    with search.use(number) as part:
        return suffer(part.model, arguments.level).draw_example(max(arguments.touches), rng)[0]


def measure_once(kept: Path | None, measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return what is kept in a file. If there is no such file, measure, and keep the result there."""
    if kept is not None and kept.exists():
        row: dict[str, Any] = json.loads(kept.read_text())
        return row
    row = measure()
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(row))
    return row


def measure_object(search: PartSearch, name: str, touches: list[Touch]) -> dict[str, Any]:
    """Return the objects' rough fits, and the misfits of the objects to be located, in each of the SITUATIONS."""
    like = [one for one in list_likenesses(name) if one in search.names]
    start = time.perf_counter()
    candidates = find_candidates(touches, search)
    chosen = candidates.choose(replace(LOCATED, most_behind=np.inf, most=LOCATED.most + 1 + len(like)))
    with ExitStack() as stack:
        models = {search.names[k]: stack.enter_context(search.use(k)).model for k in chosen}
    said = identify(touches, list(models.values()))
    located = [one for one in said.objects if one.found is not None]
    row: dict[str, Any] = {
        "object": name, "touches": len(touches), "seconds": time.perf_counter() - start, "likenesses": like,
        "alike": dict(zip(search.names, candidates.alike.tolist(), strict=True)),
        "rough_misfits": {name: fit.misfit for name, fit in zip(search.names, candidates.fits, strict=True)},
        "misfits": {one.name: one.misfit for one in located},
        "imprint_ious": {one.name: one.found.best.imprint_iou for one in located if one.found is not None},
        "floors": {KNOWN: list(said.floors)},
    }  # fmt: skip
    for situation in (LIKENESS, UNKNOWN) if like else (UNKNOWN,):
        names = list_located(row, situation)
        some = [(models[one.name], one) for one in located if one.name in names]
        row["floors"][situation] = find_floors(touches, some).tolist()
    return row


def measure_example(
    search: PartSearch, name: str, count: int, arguments: argparse.Namespace, again: int
) -> dict[str, Any]:
    """Return what `measure_object` returns for `count` touches of an object, among as many parts as requested."""
    touches = draw_example(search, search.names.index(name), arguments, again)[:count]
    if arguments.among is not None:
        rng = np.random.default_rng([arguments.seed, *map(ord, name), again, arguments.among])
        search = choose_among(search, name, arguments.among, rng)
    return measure_object(search, name, touches)


def list_located(row: dict[str, Any], situation: str) -> list[str]:
    """Return the names of the objects that `identify` locates in one of the SITUATIONS, by their rough fit.

    All were searched with the touched object in the library. Its size may have added its likenesses to the search.
    """
    out = {KNOWN: set(), LIKENESS: {row["object"]}, UNKNOWN: {row["object"], *row["likenesses"]}}[situation]
    others = [name for name in row["alike"] if name not in out]
    others.sort(key=lambda name: (row["rough_misfits"][name], -row["alike"][name]))
    return [others[k] for k in LOCATED.choose(np.array([-row["rough_misfits"][name] for name in others]))]


def answer(row: dict[str, Any], situation: str) -> tuple[list[str], KnownAnswer]:
    """Return the located objects and the result in one of the SITUATIONS."""
    names = list_located(row, situation)
    misfits = np.array([row["misfits"].get(name, np.inf) for name in names])
    truth = names.index(row["object"]) if row["object"] in names else -1
    return names, KnownAnswer(misfits, np.array(row["floors"][situation]), truth, situation != KNOWN)


def is_called_certain(p: NDArray[np.float64], none: float) -> bool:
    """Return whether the verdict on the most probable object is "certain". Poor fits are not known here."""
    right = float(p.max())
    return judge_pose(Outcome(right, max(0.0, 1 - right - none), none)) is Verdict.CERTAIN


def is_own_first(row: dict[str, Any], key: str, best: Callable[[Iterable[float]], float]) -> bool:
    """Return whether an example's own object has the `best` value of `key`: the greatest or the least."""
    return bool(row[key][row["object"]] == best(row[key].values()))


class Judged(NamedTuple):
    """The answer to an example: the objects' probabilities, and how far it is right."""

    row: dict[str, Any]
    truth: int
    names: list[str]
    p: NDArray[np.float64]
    none: float
    certain: bool

    @property
    def first(self) -> str:
        """The most probable object."""
        return self.names[int(self.p.argmax())]

    @property
    def right(self) -> bool:
        """Whether the touched object is the most probable one, and more probable than "none of these"."""
        return self.first == self.row["object"] and bool(self.p.max() > self.none)


def judge(rows: list[dict[str, Any]], null: NullEvidence, situation: str) -> list[Judged]:
    """Return the answer to each example that has the situation."""
    judged = []
    for row in rows:
        if situation in row["floors"]:
            names, known = answer(row, situation)
            p, none = null.probabilities(known.misfits, known.floors)
            judged.append(Judged(row, known.truth, names, p, none, is_called_certain(p, none)))
    return judged


def summarise(rows: list[dict[str, Any]], null: NullEvidence) -> tuple[dict[str, float], Counter[tuple[str, str]]]:
    """Return shares over examples with the same number of touches, and the confused objects."""
    known, unknown, like = (judge(rows, null, situation) for situation in SITUATIONS)
    limit = np.quantile([one.none for one in known], 1 - FALSE_ALARMS)
    certain = [one.right for one in known if one.certain]
    taken = Counter(
        (one.row["object"], one.first if one.p.max() > one.none else "none") for one in known if not one.right
    )  # fmt: skip
    return {
        "examples": len(rows), "glanced": np.mean([is_own_first(row, "alike", max) for row in rows]),
        "looked_into": np.mean([is_own_first(row, "rough_misfits", min) for row in rows]),
        "located": np.mean([one.truth >= 0 for one in known]),
        "first": np.mean([one.first == one.row["object"] for one in known]),
        "inseparable": np.mean([one.truth >= 0 and one.p[one.truth] >= AS_PROBABLE * one.p.max() for one in known]),
        "right": np.mean([one.right for one in known]),
        "rejected": np.mean([one.none > 0.5 for one in unknown]),
        "rejected_at_5": np.mean([one.none > limit for one in unknown]),
        "certain": len(certain) / len(rows), "certain_right": np.mean(certain) if certain else np.nan,
        "strange_certain": np.mean([one.certain for one in unknown]), "likenesses": len(like),
        "like_rejected": np.mean([one.none > 0.5 for one in like]) if like else np.nan,
        "like_named": np.mean([one.first in one.row["likenesses"] for one in like]) if like else np.nan,
        "like_certain": np.mean([one.certain for one in like]) if like else np.nan,
        "seconds": np.median([row["seconds"] for row in rows]),
    }, taken  # fmt: skip


def compare_shares(rows: list[dict[str, Any]], null: NullEvidence) -> Iterator[tuple[str, list[float]]]:
    """Yield for "none of these" and for the first object, and each bin of BINS, what is stated and what is true.

    The values are the number of examples, their weight, the mean probability, and the share for which it is true.
    Unknown objects count less than known ones, so that their share is the prior of `null`.
    """
    known, unknown = (judge(rows, null, situation) for situation in (KNOWN, UNKNOWN))
    weights = np.repeat([(1 - null.prior) / len(known), null.prior / len(unknown)], [len(known), len(unknown)])
    every = [*known, *unknown]
    strange = np.repeat([False, True], [len(known), len(unknown)])
    first = np.array([one.first == one.row["object"] for one in every])
    none, best = np.array([one.none for one in every]), np.array([one.p.max() for one in every])
    for what, said, true in ((NONE, none, strange), ("first object", best, first)):
        bins = np.digitize(said, BINS)
        for k in range(len(BINS) + 1):
            if (some := bins == k).any():
                said_mean, share = (float(np.average(values[some], weights=weights[some])) for values in (said, true))
                yield what, [int(some.sum()), float(weights[some].sum()), said_mean, share]


def time_comparisons(search: PartSearch, touches: list[Touch]) -> float:
    """Return the time of a quick comparison with all objects. An earlier one, not timed, opens their models."""
    search.compare(touches)
    start = time.perf_counter()
    search.compare(touches)
    return time.perf_counter() - start


def main() -> None:
    """Measure, print tables, and keep the examples if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", help="FILE[:UNITS], or demo objects, to build the library from")
    parser.add_argument("--library", type=Path, required=True, help="library on disk; with meshes, it is built there")
    parser.add_argument("--asked", default="", help="regular expression for the names of touched objects")
    parser.add_argument("--most", type=int, help="number of touched objects; default: all")
    parser.add_argument("--among", type=int, help="identify among as many random parts; default: all")
    parser.add_argument("--sensor", default="gelsight-mini")
    parser.add_argument("--level", default="clean", choices=list(SUFFERING))
    parser.add_argument("--touches", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--examples", type=int, default=1, help="examples of each object")
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--sizes", nargs="*", type=int, default=[], help="sizes of libraries to time")
    parser.add_argument("--store", type=Path, help="store of models")
    parser.add_argument("--out", type=Path, help="folder with a file for each object and number of touches")
    arguments = parser.parse_args()
    search = open_search(arguments)
    rows = []
    for count in arguments.touches:
        for name in choose_asked(search, arguments.asked, arguments.most):
            for again in range(arguments.examples):
                label = f"{name}-{arguments.level}-{count}-{again}-{arguments.among or len(search)}.json"
                kept = arguments.out / label if arguments.out else None
                rows.append(measure_once(kept, partial(measure_example, search, name, count, arguments, again)))
    report(rows, arguments)
    for size in arguments.sizes:
        some = choose_among(search, search.names[0], size, np.random.default_rng(arguments.seed))
        touches = draw_example(some, 0, arguments, 0)[:2]
        compared_s = time_comparisons(some, touches)
        start = time.perf_counter()
        identify_part(touches, some)
        identified_s = time.perf_counter() - start
        print(f"{size} objects, two touches: compared in {1e3 * compared_s:.0f} ms, identified in {identified_s:.1f} s")


def report(rows: list[dict[str, Any]], arguments: argparse.Namespace) -> None:
    """Print the tables and the confused objects."""
    null = NullEvidence()
    if arguments.fit:
        null = fit_null_evidence([answer(row, key)[1] for row in rows for key in (KNOWN, UNKNOWN)])
        print(null)
    header = (
        "| touches | examples | first at once | first | located | most probable | or inseparable | right | certain "
    )
    header += "| of these right | unknown: rejected | at 5 % false alarms | certain | s |"
    print(f"{header}\n{'|---' * 14}|")
    counts = sorted({row["touches"] for row in rows})
    said = {count: summarise([row for row in rows if row["touches"] == count], null) for count in counts}
    for count, (shares, taken) in said.items():
        print(f"| {count} | {shares['examples']} | {format_shares(shares, SHARES)} | {shares['seconds']:.1f} |")
        for (own, other), times in taken.items():
            print(f"  {count} touches: {own} taken for {other}" + (f", {times} times" if times > 1 else ""))
    print("\n| touches | examples with a likeness | rejected | likeness first | called certain |")
    print("|---" * 5 + "|")
    for count, (shares, _) in said.items():
        print(f"| {count} | {shares['likenesses']} | {format_shares(shares, LIKE_SHARES)} |")
    print("\n| probability of | examples | weight | stated | true |")
    print("|---" * 5 + "|")
    for what, (examples, *values) in compare_shares(rows, null):
        print(f"| {what} | {examples} | {' | '.join(f'{value:.0%}' for value in values)} |")


def format_shares(shares: dict[str, float], keys: Sequence[str]) -> str:
    """Return shares as cells of a table."""
    return " | ".join("" if np.isnan(shares[key]) else f"{shares[key]:.0%}" for key in keys)


if __name__ == "__main__":
    main()
