#!/usr/bin/env python3
"""Whether mistakes of a user end in an error or in a doubt, and whether the message names the cause.

Each mistake of `mistake_cases` is made with several objects and seeds. Objects are pressed from any direction, and
drawn by ray casting. Three touches are located together, unless the mistake is about one touch. `refused` means an
error, `doubted` a verdict other than certain. A certain answer is right if its pose error is below 1 mm. If the touches
are not those of the object, it is right if the located surface is everywhere within 1 mm of the true surface.

A cause is named if the error, or a doubt about the result, has its words. A message that names more than three things
names none. The first row is without a mistake.

Meshes are given as FILE[:UNITS] or a demo object's name.
"""

import dataclasses
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from asked import load_asked, make_parser, make_source
from mistake_cases import ANY, LAYER, MISTAKES, SENSOR, WORDS, Given, Mistake
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.sensor_files import write_sensor_file
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.doubts import list_doubts
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.store.store import StageStore

OUTCOMES = ("refused", "doubted", "right", "wrong")
TOUCHES = 3
AWAY_M = 0.3  # of the object from the base, about
RIGHT_M = 1e-3
MOST_NAMED = 3  # things that a message may name
NONE = Mistake("no mistake", lambda given: given, ("right",), ())


@dataclass(frozen=True)
class Answer:
    """The outcome of a mistake, one of OUTCOMES, and the message, "" if there is none."""

    outcome: str
    message: str = ""

    def names(self, causes: Sequence[str]) -> bool:
        """Return whether the message names one of the causes, and few other things."""
        named = [cause for cause, words in WORDS.items() if re.search(words, self.message)]
        return 0 < len(named) <= MOST_NAMED and any(cause in named for cause in causes)


@dataclass(frozen=True, eq=False)
class Bench:
    """Makes mistakes with objects. Meshes and sensors are written to `folder`."""

    objects: tuple[str, ...]
    folder: Path
    store: StageStore

    def make_localizer(self, mesh: TriangleMesh, sensor: dict[str, Any], pitch: float = 1.0) -> Localizer:
        """Make a localizer of a mesh and a sensor, whose pixels are `pitch` times as large as they are."""
        path = self.folder / f"{mesh.digest}.stl"
        if not path.exists():
            trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).export(path)
        made = Localizer.create(path, units="m", store=self.store, sensor=sensor)
        if pitch == 1:
            return made
        geometry = made.sensor.geometry
        wide = dataclasses.replace(geometry, fx=geometry.fx / pitch, fy=geometry.fy / pitch)
        file = write_sensor_file(self.folder / f"sensor-{pitch}.toml", wide)
        return Localizer.create(path, units="m", store=self.store, sensor={"name": "file", "path": str(file)})

    def give(self, number: int, seed: int, took: dict[str, Any]) -> Given:
        """Return what a user without mistakes gives about an object. The other object is the next one."""
        rng = np.random.default_rng([seed, number])
        mesh, other = (load_asked(self.objects[k % len(self.objects)]).mesh for k in (number, number + 1))
        touches = self.draw_touches(mesh, took, rng)
        truth = make_transform(draw_rotations(1, rng)[0], AWAY_M * rng.normal(size=3))
        return Given(
            tuple(touch.contact_shape.depth_m for touch in touches),
            tuple(truth @ touch.T_base_sensor for touch in touches),
            tuple(touch.press_depth_m for touch in touches),
            truth,
            mesh,
            (other, self.draw_touches(other, took, rng)[0].contact_shape.depth_m),
            rng,
        )

    def draw_touches(self, mesh: TriangleMesh, sensor: dict[str, Any], rng: np.random.Generator) -> list[Touch]:
        """Draw touches of an object at rest."""
        localizer = self.make_localizer(mesh, sensor)
        return make_source(localizer.object, localizer.sensor.geometry).draw_example(TOUCHES, rng)[0]

    def answer(self, mistake: Mistake, given: Given) -> Answer:
        """Make a mistake, and judge its outcome."""
        try:
            wrong = mistake.make(given)
            found = self.locate(wrong)
        except TactileLocError as error:
            return Answer("refused", str(error))
        if found.verdict is not Verdict.CERTAIN:
            return Answer("doubted", "; ".join(list_doubts(found)))
        T, T_true = found.best.T_sensor_object, invert(given.poses[0]) @ given.truth
        if mistake.lost:
            error_m = measure_surface_error(given.mesh, wrong.mesh, invert(T_true) @ T)
        else:
            true = self.make_localizer(given.mesh, SENSOR).object
            error_m = float(measure_pose_errors(true, T[None], T_true)[0])
        return Answer("right" if error_m < RIGHT_M else "wrong")

    def locate(self, given: Given) -> Localization:
        """Locate the object by what a user gives."""
        localizer = self.make_localizer(given.mesh, given.sensor, given.pitch)
        options = dict(given.read)
        press = options.pop("press", None)
        read = Touch.from_depth if "kind" in options else Touch.from_mask
        touches = [
            read(
                one, sensor=localizer.sensor, name=f"touch-{k}", T_base_sensor=given.poses[k], **options,
                press_depth_m=press and min(press * given.press_m[k], localizer.sensor.geometry.max_depth_m),
            )
            for k, one in enumerate(given.maps)
        ]  # fmt: skip
        return localize_together([(localizer, touch) for touch in touches], given.prior)


def measure_surface_error(true: TriangleMesh, located: TriangleMesh, T_true_located: np.ndarray) -> float:
    """Return the largest distance of a corner of the located mesh from the true surface, metres."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(true.vertices_m.astype(np.float32), true.faces.astype(np.uint32))
    corners = transform_points(T_true_located, located.vertices_m).astype(np.float32)
    return float(scene.compute_distance(corners).numpy().max())


def make_all(bench: Bench, seeds: int, only: str) -> Iterator[tuple[Mistake, list[Answer]]]:
    """Make the mistakes whose names contain a text, each with all objects and seeds."""
    give = cache(lambda number, seed, elastic: bench.give(number, seed, LAYER if elastic else SENSOR))
    for mistake in (NONE, *MISTAKES):
        if only in mistake.name:
            drawn = [
                (np.random.default_rng([seed, number]), give(number, seed, mistake.took is LAYER))
                for number in range(len(bench.objects))
                for seed in range(seeds)
            ]
            yield mistake, [bench.answer(mistake, dataclasses.replace(one, rng=rng)) for rng, one in drawn]


def describe(mistake: Mistake, answers: Sequence[Answer]) -> str:
    """Return the row of a mistake."""
    counts = Counter(answer.outcome for answer in answers)
    expected = " or ".join(mistake.expected) if mistake.expected != ANY else "any"
    if mistake.reason:
        expected += f": {mistake.reason}"
    named, told = count_named(mistake, answers)
    return (
        f"| {mistake.name} | {expected} | {' | '.join(str(counts[outcome]) for outcome in OUTCOMES)} | "
        f"{', '.join(mistake.causes) or '-'} | {named} of {told} |"
    )


def count_named(mistake: Mistake, answers: Sequence[Answer]) -> tuple[int, int]:
    """Return how many refusals and doubts name a cause of the mistake, and the number of all of them."""
    told = [answer for answer in answers if answer.outcome in ("refused", "doubted")]
    return sum(answer.names(mistake.causes) for answer in told), len(told)


def total(rows: Sequence[tuple[Mistake, list[Answer]]]) -> str:
    """Return the table of all mistakes together."""
    answers = [(mistake, answer) for mistake, some in rows for answer in some]
    wrong = sum(answer.outcome == "wrong" for _, answer in answers)
    shown = [(m, a) for m, a in answers if not m.reason]
    wrong_shown = sum(answer.outcome == "wrong" for _, answer in shown)
    named = [named > told / 2 for named, told in (count_named(*row) for row in rows) if told]
    good = sum(answer.outcome in mistake.expected or mistake.expected == ANY for mistake, answer in answers)
    lines = [
        ("answers as expected", good, len(answers)),
        ("certain and wrong", wrong, len(answers)),
        ("certain and wrong, if the touches can show the mistake", wrong_shown, len(shown)),
        ("mistakes whose cause most messages name", sum(named), len(named)),
    ]
    body = "\n".join(f"| {text} | {count} of {of} | {100 * count / max(of, 1):.1f} % |" for text, count, of in lines)
    return f"\n| all mistakes | number | share |\n|---|---|---|\n{body}"


def main() -> None:
    """Make all mistakes, and print a table of them, and one of all together."""
    parser = make_parser(__doc__, read_split("bent"))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", default="", help="make only the mistakes whose names contain this text")
    parser.add_argument("--messages", action="store_true", help="print each message, too")
    arguments = parser.parse_args()
    print("| mistake | expected | refused | doubted | certain, right | certain, wrong | cause | named |")
    print("|---|---|---|---|---|---|---|---|")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(tuple(arguments.objects), Path(folder), StageStore(Path(folder) / "store"))
        for mistake, answers in make_all(bench, arguments.seeds, arguments.only):
            print(describe(mistake, answers), flush=True)
            for answer in answers if arguments.messages else ():
                print(f"    {answer.outcome}: {answer.message}", flush=True)
            rows += [(mistake, answers)] if mistake is not NONE else []
    if rows:
        print(total(rows))


if __name__ == "__main__":
    main()
