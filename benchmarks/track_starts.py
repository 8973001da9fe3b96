#!/usr/bin/env python3
"""Tracks from an unknown start: how often they end right, and whether their verdicts are right.

Each slide is drawn by ray casting, as in sequences.py: clean, with mild noise, or on an elastic gel whose surface
ContactMechanics computes. Slides with even numbers are of one finger, all others of two fingers at different places.
The tracker is not told where the object is. Elastic slides have 25 frames a second, all others 100. A pose is right if
its pose error is at most 1 mm.

The key touches of a frame are all touches so far, thinned to at most KEYS sensor poses at least APART_MM apart. They
are also located together, without the tracker. They determine the pose if no listed wrong pose explains them as
well as the true pose: to within 0.02 of its imprint IoU. The true pose is registered to the touches first, as
all listed poses are, because the tracker knows only the reported sensor poses.

*Certain and wrong* is the share of all frames that are called certain although the first pose is wrong. *Certain, of
determined* is the share of frames called certain, of all frames whose key touches determine the pose. *Ends right*
counts slides whose last pose is right: by the tracker, and by the key touches located together. *Searching* and
*tracking* are the times of frames with and without a search: the median and the 99th percentile. Each slide is appended
to a file, from which the same command continues. Meshes are given as FILE[:UNITS] or a demo object's name.
"""

import argparse
import dataclasses
import itertools
import json
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from asked import make_source, name_asked, open_asked
from elastic_gel import SIZES_PX, add_noise, press_elastic, view_as
from sequences import SENSOR_STD_M, SENSOR_STD_RAD
from tactile_loc_benchmark.sliding_touches import Frame, SlidingTouches
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.runtime.errors import TactileLocError, TouchError
from tactile_loc.core.sensing.gel import RIGID, Gel
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.locate.hypotheses import compare_refined
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.freedom import explain_as_well
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.store.store import StageStore
from tactile_loc.tracking.key_search import measure_motion_m
from tactile_loc.tracking.tracker import Tracker

MM = 1e3
RIGHT_MM = 1.0
KEYS, APART_MM, LEVER_M = 5, 2.0, 0.01
WIDER = 1.5  # growth of the least distance while there are too many key touches
LISTED = 30  # poses among which a rival of the true pose is sought
SENSOR = "gelsight-mini"
DURATION_S, RATE_HZ, ELASTIC_RATE_HZ = 2.0, 100.0, 25.0
LAYER = Gel(4e-3, 0.48)
CLEAN, NOISY, ELASTIC = CONDITIONS = ("clean", "noisy", "elastic")


@dataclass(frozen=True)
class Drawn:
    """What identifies an example: its object, its condition and its number."""

    object: str
    condition: str
    number: int


Example = TypeVar("Example", bound=Drawn)


@dataclass(frozen=True)
class Slide(Drawn):
    """One slide of one finger or two: a row of lists for its F frames.

    `off_mm` is the pose error of the tracker's first pose, infinite without a pose, and `batch_mm` that of the
    key touches located together. `determined` states whether these touches determine the pose.
    """

    verdicts: list[str]
    off_mm: list[float]
    searched: list[bool]
    ms: list[float]
    batch_mm: list[float]
    batch_certain: list[bool]
    determined: list[bool]

    @property
    def fingers(self) -> int:
        """The number of fingers."""
        return 1 + self.number % 2


def make_localizer(mesh: str, condition: str, store: StageStore) -> Localizer:
    """Return the localizer of FILE[:UNITS] for slides of a condition."""
    sensor: dict[str, object] = {"name": SENSOR, "image_size_px": SIZES_PX[SENSOR]}
    if condition == ELASTIC:
        sensor |= {"gel": "layer", "gel_thickness_mm": MM * LAYER.thickness_m, "poisson": LAYER.poisson}
    return open_asked(mesh, store=store, sensor=sensor)


def make_sliding(localizer: Localizer, condition: str) -> tuple[RobotTouches, SlidingTouches]:
    """Return the source of single touches on a rigid gel, and that of the slides of a condition."""
    geometry = dataclasses.replace(localizer.scene.geometry, gel=RIGID)
    source = make_source(
        localizer.object, geometry,
        noise=NOISE["mild" if condition == NOISY else "none"], sensor_std_m=SENSOR_STD_M, sensor_std_rad=SENSOR_STD_RAD,
    )  # fmt: skip
    return source, SlidingTouches(source, ELASTIC_RATE_HZ if condition == ELASTIC else RATE_HZ)


def draw_slide(localizer: Localizer, condition: str, rng: np.random.Generator) -> list[Frame]:
    """Return the frames of one finger of a slide."""
    source, sliding = make_sliding(localizer, condition)
    frames = sliding.draw_example(round(DURATION_S * sliding.rate_hz), rng)
    return [soften(frame, source, localizer, rng) for frame in frames] if condition == ELASTIC else frames


def soften(frame: Frame, source: RobotTouches, localizer: Localizer, rng: np.random.Generator) -> Frame:
    """Return the frame on an elastic gel, with mild noise."""
    if frame.touch is None:
        return frame
    elastic = view_as(press_elastic(frame.touch, source, LAYER), localizer.scene.geometry.gel)
    try:
        return dataclasses.replace(frame, touch=add_noise(elastic, source, NOISE["mild"], rng))
    except TouchError:  # noise has hidden the contact
        return dataclasses.replace(frame, touch=None)


def locate_keys(localizer: Localizer, touches: Sequence[Touch]) -> tuple[float, bool, bool]:
    """Return the pose error, mm, of touches located together, if it is certain, and if they determine the pose."""
    observations = [(localizer, touch) for touch in touches]
    try:
        found = localize_together(observations, top=LISTED)
    except TactileLocError:
        return np.inf, False, False
    poses = np.stack([h.T_sensor_object for h in found.hypotheses])
    off_m = measure_pose_errors(localizer.object, poses, np.asarray(touches[0].T_sensor_object))
    rivals = np.array([h.imprint_iou for h in found.hypotheses])[MM * off_m > RIGHT_MM]
    determined = not explain_as_well(rivals, explain_by_truth(localizer, touches, found.agreement.outliers)).any()
    return MM * float(off_m[0]), found.verdict is Verdict.CERTAIN, determined


def explain_by_truth(localizer: Localizer, touches: Sequence[Touch], outliers: Sequence[int] = ()) -> float:
    """Return the mean imprint IoU, 0 to 1, of the true pose, registered to touches and their reported sensor poses.

    Touches whose numbers are in `outliers` do not count.
    """
    views = localizer.make_views(touches)
    trusted = [number for number in range(len(touches)) if number not in outliers]
    true = Candidate(np.asarray(touches[0].T_sensor_object), -1, 0.0)
    registered = localizer.refinement.refine([views[number] for number in trusted], [true])
    return float(compare_refined(views, registered, trusted)[0, trusted].mean())


def choose_key_touches(touches: Sequence[Touch]) -> list[Touch]:
    """Return at most KEYS touches, in order, whose sensor poses are at least APART_MM apart, those with most contact.

    If there are more, they have to be farther apart.
    """
    kept, apart_m = thin(touches, APART_MM / MM), APART_MM / MM
    while len(kept) > KEYS:
        apart_m *= WIDER
        kept = thin(kept, apart_m)
    return kept


def thin(touches: Sequence[Touch], apart_m: float) -> list[Touch]:
    """Return touches whose sensor poses are at least `apart_m` metres apart; of nearer ones, that with more contact."""
    kept: list[Touch] = []
    for touch in touches:
        T, gel_m = np.asarray(touch.T_base_sensor), touch.geometry.gel_middle_m
        near = [k for k in kept if measure_motion_m(np.asarray(k.T_base_sensor), T, gel_m, LEVER_M) < apart_m]
        if all(touch.contact_share > one.contact_share for one in near):
            kept = [*(one for one in kept if all(one is not other for other in near)), touch]
    return kept


def measure_off_mm(localizer: Localizer, T: np.ndarray | None, frame: Frame) -> float:
    """Return the pose error, mm, of a pose (4, 4), metres, in a frame's sensor frame; infinite without a pose."""
    if T is None:
        return np.inf
    return MM * float(measure_pose_errors(localizer.object, T[None], frame.T_sensor_object)[0])


def locate_by_keys(localizer: Localizer, shown: Sequence[Sequence[Touch | None]]) -> Iterator[tuple[float, bool, bool]]:
    """Yield what `locate_keys` returns for the key touches so far, for each frame's touches of all fingers."""
    touches: list[Touch] = []
    keys: list[int] = []
    batch = (np.inf, False, False)
    for each in shown:
        touches = thin([*touches, *(touch for touch in each if touch is not None)], APART_MM / MM)
        chosen = choose_key_touches(touches)
        if list(map(id, chosen)) != keys:
            keys, batch = list(map(id, chosen)), locate_keys(localizer, chosen)
        yield batch


def make_seed(localizer: Localizer, condition: str, number: int, seed: int) -> list[int]:
    """Return the seed of an example."""
    return [seed, zlib.crc32(localizer.object.name.encode()), CONDITIONS.index(condition), number]


def track(localizer: Localizer, condition: str, number: int, seed: int) -> Slide:
    """Return one slide, tracked, and located by its key touches."""
    slide = Slide(localizer.object.name, condition, number, [], [], [], [], [], [], [])
    rngs = np.random.default_rng(make_seed(localizer, condition, number, seed)).spawn(slide.fingers)
    frames = list(zip(*(draw_slide(localizer, condition, rng) for rng in rngs), strict=True))
    shown = [[frame.touch for frame in each] for each in frames]
    tracker, finger = Tracker(localizer), 0
    for each, touches, batch in zip(frames, shown, locate_by_keys(localizer, shown), strict=True):
        start = time.perf_counter()
        found = tracker.update(each[0].time_s, touches, each[0].T_base_sensor if len(each) == 1 else None)
        slide.ms.append(1e3 * (time.perf_counter() - start))
        finger = next((k for k, touch in enumerate(touches) if touch is not None), finger)
        slide.verdicts.append(str(found.verdict))
        slide.searched.append(found.searched)
        slide.off_mm.append(measure_off_mm(localizer, found.T_sensor_object, each[finger]))
        for values, value in zip((slide.batch_mm, slide.batch_certain, slide.determined), batch, strict=True):
            values.append(value)  # type: ignore[attr-defined]
    return slide


def write_times(ms: np.ndarray) -> str:
    """Return the median and the 99th percentile of times."""
    return f"{np.median(ms):.0f} ({np.quantile(ms, 0.99):.0f})" if len(ms) else "-"


def write_row(name: str, slides: Sequence[Slide]) -> str:
    """Return one row of the table."""
    certain = np.concatenate([[one == "certain" for one in slide.verdicts] for slide in slides])
    right, determined, searched, ms, alike = (
        np.concatenate([getattr(slide, key) for slide in slides])
        for key in ("off_mm", "determined", "searched", "ms", "batch_certain")
    )
    right, searched, determined = right <= RIGHT_MM, searched.astype(bool), determined.astype(bool)
    ends = sum(slide.off_mm[-1] <= RIGHT_MM for slide in slides)
    batch = sum(slide.batch_mm[-1] <= RIGHT_MM for slide in slides)
    share = f"{certain[determined].mean():.0%}, {alike[determined].mean():.0%}" if determined.any() else "-"
    return (
        f"| {name} | {len(slides)} | {ends}, {batch} | {certain.mean():.0%} | {(certain & ~right).mean():.1%} | "
        f"{determined.mean():.0%} | {share} | {write_times(ms[searched])} | {write_times(ms[~searched])} |"
    )


HEAD = (
    "| slides | number | end right: tracker, key touches | certain | certain and wrong | determined | certain, of "
    "determined: tracker, key touches | searching, ms | tracking, ms |\n" + "|---" * 9 + "|"
)


def make_parser(about: str | None, counted: str, count: int, seed: int) -> argparse.ArgumentParser:
    """Return the options of a benchmark that draws `counted` examples of each object and condition."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", default=read_split("demo"))
    parser.add_argument(f"--{counted}", dest="count", type=int, default=count, help="of each object and condition")
    parser.add_argument("--conditions", nargs="*", default=list(CONDITIONS), choices=CONDITIONS)
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--store", type=Path)
    parser.add_argument("--out", type=Path, help="JSON lines of examples, from which the same command continues")
    return parser


def collect(
    arguments: argparse.Namespace, kind: type[Example], measure: Callable[[Localizer, str, int, int], Example]
) -> list[Example]:
    """Return all examples; measure those that the file of examples lacks, and append them to it."""
    store = StageStore(arguments.store)
    with tempfile.TemporaryDirectory() as folder:
        out = arguments.out or Path(folder) / "examples.jsonl"
        examples = [kind(**json.loads(line)) for line in out.read_text().splitlines()] if out.exists() else []
        known = {(one.object, one.condition, one.number) for one in examples}
        for mesh, condition in itertools.product(arguments.meshes, arguments.conditions):
            name = name_asked(mesh)
            missing = [n for n in range(arguments.count) if (name, condition, n) not in known]
            localizer = make_localizer(mesh, condition, store) if missing else None
            for number in missing:
                assert localizer is not None
                examples.append(measure(localizer, condition, number, arguments.seed))
                with out.open("a") as file:
                    file.write(json.dumps(dataclasses.asdict(examples[-1])) + "\n")
                print(f"{name} {condition} {number}: done", file=sys.stderr, flush=True)
    return examples


def print_table(
    head: str,
    write: Callable[[str, Sequence[Example]], str],
    examples: Sequence[Example],
    name: Callable[[Example], str] = lambda one: one.condition,
) -> None:
    """Print a table with a row for each name of examples, and one for all."""
    print(head)
    for key in dict.fromkeys(map(name, sorted(examples, key=lambda one: CONDITIONS.index(one.condition)))):
        print(write(key, [one for one in examples if name(one) == key]))
    print(write("all", examples))


def name_slide(slide: Slide) -> str:
    """Return the name of a slide's row in the table."""
    return f"{slide.condition}, {('one finger', 'two fingers')[slide.fingers - 1]}"


def main() -> None:
    """Print the table."""
    slides = collect(make_parser(__doc__, "slides", 2, 7).parse_args(), Slide, track)
    print_table(HEAD, write_row, slides, name_slide)


if __name__ == "__main__":
    main()
