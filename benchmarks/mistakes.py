#!/usr/bin/env python3
"""Whether mistakes of a user end in an error or in a verdict other than certain.

Each mistake is made with several objects and seeds. Objects are pressed from any direction, and drawn by ray casting.
Three touches are located together, unless the mistake is about one touch. The expected outcome of each mistake was
written down before the first run. `refused` means an error, `doubted` a verdict other than certain. For some mistakes,
the data cannot show that something is wrong. The table counts the outcomes.

Meshes are given as FILE[:UNITS] or a demo object's name.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from asked import make_parser, make_source, split_asked
from numpy.typing import NDArray
from tactile_loc_benchmark.suite import read_split

from tactile_loc.core.geometry.rigid import invert, make_transform, rotation_about
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.localizer import Localizer, localize_together
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.store.store import StageStore

SENSOR, OTHER_SENSOR = {"name": "gelsight-mini", "image_size_px": (160, 120)}, {"name": "digit"}
REFUSED, DOUBTED, CERTAIN = "refused", "doubted", "certain"
SAFE = (REFUSED, DOUBTED)
ANY = (*SAFE, CERTAIN)
TOUCHES = 3


@dataclass(frozen=True, eq=False)
class Case:
    """An object, another object, and touches of the first one at rest. Meshes are written to `folder`."""

    name: str
    other_name: str
    units: str
    folder: Path
    store: StageStore
    touches: tuple[Touch, ...]
    rng: np.random.Generator

    def make_localizer(self, name: str | None = None, units: str | None = None) -> Localizer:
        """Make a localizer of the object, or of another mesh, with the sensor that took the touches."""
        return Localizer.create(name or self.name, units=units or self.units, store=self.store, sensor=SENSOR)  # type: ignore[arg-type]

    @cached_property
    def localizer(self) -> Localizer:
        """The localizer that makes no mistake."""
        return self.make_localizer()

    @property
    def touch(self) -> Touch:
        """The first touch."""
        return self.touches[0]

    def locate(self, touches: Sequence[Touch], localizer: Localizer | None = None) -> Localization:
        """Locate touches together."""
        return localize_together([(localizer or self.localizer, touch) for touch in touches])

    def locate_mesh(self, change: Callable[[TriangleMesh], TriangleMesh], name: str) -> Localization:
        """Locate the touches with a changed mesh of their object."""
        mesh = change(self.localizer.object.mesh)
        path = self.folder / f"{Path(self.name).stem}-{name}.stl"
        trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).export(path)
        return self.locate(self.touches, self.make_localizer(str(path), "m"))

    def reread(self, change: Callable[[NDArray[np.float32]], NDArray[np.float64]], **stated: str) -> Localization:
        """Locate the touches after a change of their maps of distances (H, W), metres."""
        return self.locate([self._remake(touch, change, **stated) for touch in self.touches])

    def _remake(self, touch: Touch, change: Callable[..., NDArray[np.float64]], **stated: str) -> Touch:
        stated = {"kind": "distance", **stated}
        return Touch.from_depth(
            change(touch.contact_shape.depth_m), sensor=self.localizer.sensor, T_base_sensor=touch.T_base_sensor,
            name=touch.name, **stated,
        )  # type: ignore[arg-type] # fmt: skip

    def move(self, change: Callable[[int, NDArray[np.float64]], NDArray[np.float64]]) -> Localization:
        """Locate the touches after a change of each sensor's pose (4, 4), given its number."""
        return self.locate(
            [
                dataclasses.replace(touch, T_base_sensor=change(number, np.asarray(touch.T_base_sensor)))
                for number, touch in enumerate(self.touches)
            ]
        )


def invert_maps(case: Case) -> Localization:
    """Give maps in which 0 means no contact as distances."""
    return case.locate(
        [
            case._remake(touch, lambda depth, press=touch.indentation_m: np.maximum(press - depth, 0.0))
            for touch in case.touches
        ]
    )


def state_heights(case: Case) -> Localization:
    """Give distances as heights above the untouched gel."""
    return case.reread(lambda depth: depth.astype(float), kind="height")


def give_millimetres(case: Case) -> Localization:
    """Give depths in millimetres as metres."""
    return case.reread(lambda depth: 1e3 * depth.astype(float))


def give_metres(case: Case) -> Localization:
    """Give depths in metres as millimetres."""
    return case.reread(lambda depth: depth.astype(float), unit="mm")


def mirror_images(case: Case) -> Localization:
    """Mirror the images from left to right."""
    return case.reread(lambda depth: depth[:, ::-1].astype(float))


def mirror_one_image(case: Case) -> Localization:
    """Mirror the image of a single touch. A mirrored contact is a contact of many objects."""
    return case.locate([case._remake(case.touch, lambda depth: depth[:, ::-1].astype(float))])


def turn_images(case: Case) -> Localization:
    """Turn the images by half a turn."""
    return case.reread(lambda depth: depth[::-1, ::-1].astype(float))


def swap_sensors(case: Case) -> Localization:
    """Locate with another sensor than the one that took the touches."""
    other = Localizer.create(case.name, units=case.units, store=case.store, sensor=OTHER_SENSOR)  # type: ignore[arg-type]
    return case.locate(case.touches, other)


def take_wrong_part(case: Case) -> Localization:
    """Locate with the mesh of another part."""
    return case.locate(case.touches, case.make_localizer(case.other_name))


def take_wrong_part_once(case: Case) -> Localization:
    """Locate one touch with the mesh of another part. Parts may have equal edges and faces."""
    return case.locate([case.touch], case.make_localizer(case.other_name))


def scale_part(case: Case) -> Localization:
    """Locate with a mesh that is 5 % too large."""
    return case.locate_mesh(lambda mesh: TriangleMesh(1.05 * mesh.vertices_m, mesh.faces), "scaled")


def take_inches(case: Case) -> Localization:
    """Locate with a mesh whose inches were read as millimetres."""
    return case.locate_mesh(lambda mesh: TriangleMesh(mesh.vertices_m / 25.4, mesh.faces), "inches")


def mirror_part(case: Case) -> Localization:
    """Locate with a mirrored mesh. The touches may show only areas that the mirrored part has, too."""
    return case.locate_mesh(lambda mesh: TriangleMesh(mesh.vertices_m * [1, 1, -1], mesh.faces[:, ::-1]), "mirrored")


def touch_two_parts(case: Case) -> Localization:
    """Mix touches of two parts."""
    foreign = draw_touches(case.make_localizer(case.other_name), 1, case.rng)
    last = dataclasses.replace(foreign[0], T_base_sensor=case.touches[-1].T_base_sensor)
    return case.locate([*case.touches[:-1], last])


def swap_poses(case: Case) -> Localization:
    """Give the first touch the sensor pose of the second one, and the other way round."""
    poses = [np.asarray(touch.T_base_sensor) for touch in case.touches]
    return case.move(lambda number, T: poses[(1, 0, *range(2, len(poses)))[number]])


def invert_poses(case: Case) -> Localization:
    """Give T_sensor_base instead of T_base_sensor."""
    return case.move(lambda number, T: invert(T))


def give_positions_in_mm(case: Case) -> Localization:
    """Give the positions of the sensors in millimetres as metres."""
    return case.move(lambda number, T: make_transform(T[:3, :3], 1e3 * T[:3, 3]))


def transpose_rotations(case: Case) -> Localization:
    """Read the sensors' quaternions in the wrong order, here as their conjugates."""
    return case.move(lambda number, T: make_transform(T[:3, :3].T, T[:3, 3]))


def move_object(case: Case) -> Localization:
    """Move the object by 5 mm between the touches."""
    step = np.array([5e-3, 0.0, 0.0])
    return case.move(lambda number, T: make_transform(T[:3, :3], T[:3, 3] + number * step))


def repeat_touch(case: Case) -> Localization:
    """Give the image of the first touch for all touches."""
    return case.locate(
        [dataclasses.replace(touch, contact_shape=case.touch.contact_shape, geometry=case.touch.geometry)
         for touch in case.touches]
    )  # fmt: skip


def leave_untouched(case: Case) -> Localization:
    """Give the image of an untouched gel."""
    return case.reread(lambda depth: np.zeros(depth.shape), kind="indentation")


def give_noise(case: Case) -> Localization:
    """Give noise of 10 um instead of touches."""
    return case.reread(lambda depth: 1e-5 * case.rng.standard_normal(depth.shape), kind="indentation")


def touch_sphere_once(case: Case) -> Localization:
    """Touch the ball at the end of a rod once. The touch does not show how the rod is turned."""
    path = case.folder / "ball.stl"
    ball = trimesh.creation.icosphere(4, 4e-3)
    rod = trimesh.creation.box((4e-3, 2e-3, 20e-3), make_transform(np.eye(3), [0.0, 0.0, 13e-3]))
    (ball + rod).export(path)
    localizer = case.make_localizer(str(path), "m")
    source = make_source(localizer.object, localizer.scene.geometry)
    T = make_transform(rotation_about([0, 1, 0], 0.9 * np.pi), [0.0, 0.0, 0.0])
    for _ in range(100):
        touch = source.approach(invert(T) @ make_transform(np.eye(3), [0, 0, -60e-3]), 1e-3, "ball", case.rng)
        if touch is not None:
            return localizer.localize(touch)
    raise RuntimeError("the sensor does not reach the ball")


@dataclass(frozen=True)
class Mistake:
    """A mistake, and its expected outcomes. `reason` states why the data may not show it."""

    make: Callable[[Case], Localization]
    expected: tuple[str, ...] = SAFE
    reason: str = ""


MISTAKES = (
    Mistake(invert_maps, (REFUSED,)),
    Mistake(state_heights, (REFUSED,)),
    Mistake(give_millimetres, (REFUSED,)),
    Mistake(give_metres, (REFUSED,)),
    Mistake(mirror_images),
    Mistake(mirror_one_image, ANY, "an edge or a corner and its mirror image look alike"),
    Mistake(turn_images),
    Mistake(swap_sensors, (REFUSED,)),
    Mistake(take_wrong_part),
    Mistake(take_wrong_part_once, ANY, "parts have equal edges and faces"),
    Mistake(scale_part),
    Mistake(take_inches),
    Mistake(mirror_part, ANY, "a part may be its own mirror image, or the touches miss the difference"),
    Mistake(touch_two_parts),
    Mistake(swap_poses),
    Mistake(invert_poses),
    Mistake(give_positions_in_mm, (REFUSED,)),
    Mistake(transpose_rotations),
    Mistake(move_object),
    Mistake(repeat_touch),
    Mistake(leave_untouched, (REFUSED,)),
    Mistake(give_noise),
    Mistake(touch_sphere_once, (DOUBTED,)),
)


def draw_touches(localizer: Localizer, count: int, rng: np.random.Generator) -> list[Touch]:
    """Draw touches of an object at rest, without their true poses."""
    touches, _ = make_source(localizer.object, localizer.scene.geometry).draw_example(count, rng)
    return [dataclasses.replace(touch, T_sensor_object=None) for touch in touches]


def judge_mistake(mistake: Mistake, case: Case) -> str:
    """Make a mistake, and return its outcome."""
    try:
        verdict = mistake.make(case).verdict
    except TactileLocError:
        return REFUSED
    return CERTAIN if verdict is Verdict.CERTAIN else DOUBTED


def main() -> None:
    """Make all mistakes, and print a table."""
    parser = make_parser(__doc__, read_split("bent"))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--only", help="make only the mistakes whose names contain this text")
    arguments = parser.parse_args()
    print("| mistake | expected | refused | doubted | certain | as expected |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(Path(folder) / "store")
        cases = list(make_cases(arguments.objects, arguments.seeds, Path(folder), store))
        for mistake in MISTAKES:
            name = mistake.make.__name__.replace("_", " ")
            if arguments.only and arguments.only not in name:
                continue
            outcomes = Counter(judge_mistake(mistake, case) for case in cases)
            good = sum(outcomes[outcome] for outcome in mistake.expected)
            expected = " or ".join(mistake.expected) if mistake.expected != ANY else f"any: {mistake.reason}"
            counts = " | ".join(str(outcomes[outcome]) for outcome in ANY)
            print(f"| {name} | {expected} | {counts} | {good} of {len(cases)} |", flush=True)


def make_cases(objects: Sequence[str], seeds: int, folder: Path, store: StageStore) -> Sequence[Case]:
    """Make a case for each object and seed. The wrong part of each object is the next object."""
    cases = []
    for number in range(len(objects)):
        (name, units), (other, _) = (split_asked(objects[k % len(objects)]) for k in (number, number + 1))
        for seed in range(seeds):
            rng = np.random.default_rng([seed, number])
            case = Case(name, other, units, folder, store, (), rng)
            drawn = draw_touches(case.localizer, TOUCHES, rng)
            cases.append(dataclasses.replace(case, touches=tuple(drawn)))
    return cases


if __name__ == "__main__":
    main()
