"""The components of bench_fakes. They press a box on a sensor with few pixels."""

import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from tactile_loc.plugin import ComponentOptions, ContactShape, ObjectModel, Scene, Touch, TouchError, TriangleMesh
from tactile_loc.plugin.helpers import SymmetryGroup, make_transform

from tactile_loc_benchmark.interfaces import (
    LocatingProblem,
    Method,
    RecordedSource,
    RecordedTouch,
    ScoredPoses,
    SimulatedSource,
)

SENSOR = 'camera = "orthographic"\nimage_size_px = [32, 32]\nmax_depth_mm = 2.0\nmm_per_px = 0.7\n'
BOX_FACES = [
    [0, 2, 1],
    [0, 3, 2],
    [4, 5, 6],
    [4, 6, 7],
    [0, 1, 5],
    [0, 5, 4],
    [1, 2, 6],
    [1, 6, 5],
    [2, 3, 7],
    [2, 7, 6],
    [3, 0, 4],
    [3, 4, 7],
]
BOX_CORNERS_M = 1e-3 * np.array(
    [[0, 0, 0], [30, 0, 0], [30, 20, 0], [0, 20, 0], [0, 0, 12], [30, 0, 12], [30, 20, 12], [0, 20, 12]], float
)


def write_sensor(folder: Path) -> dict[str, Any]:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sensor.toml").write_text(SENSOR)
    return {"name": "file", "path": str(folder / "sensor.toml")}


class Sketch(SimulatedSource):
    """Contact shapes by ray casting; a share of all presses is refused."""

    licence: ClassVar[str] = "public domain"
    libraries: ClassVar[tuple[str, ...]] = ("numpy", "not-installed-anywhere")
    drawn: ClassVar[dict[bytes, Any]] = {}  # the true poses of all touches drawn in this process

    class Options(ComponentOptions):
        refused: float = 0.0
        style: str = ""

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        return write_sensor(folder)

    def press(self, scene: Scene, T_sensor_object: Any, rng: np.random.Generator) -> ContactShape:
        if rng.random() < self.options.refused:
            raise TouchError("the gel saw nothing")
        depth_m = scene.render_contact_depths(T_sensor_object[None])[0]
        self.drawn[depth_m.tobytes()] = T_sensor_object
        return ContactShape(depth_m, scene.geometry.indentation_m)


class Photo(Sketch):
    """A source whose sensor cannot be prepared."""

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        raise ModuleNotFoundError("No module named 'camera_driver'", name="camera_driver")


class Archive(RecordedSource):
    """Two recorded touches of a box; the sensor refuses the second."""

    licence: ClassVar[str] = "CC0"

    class Options(ComponentOptions):
        folder: str = ""

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        return write_sensor(folder)

    def find_objects(self) -> Mapping[str, ObjectModel]:
        mesh = TriangleMesh(BOX_CORNERS_M, np.array(BOX_FACES, np.int64))
        return {"brick": ObjectModel("brick", mesh, SymmetryGroup.parse("none", mesh.centroid_m))}

    def read_touches(self, name: str) -> Iterable[RecordedTouch]:
        pressed = np.full((32, 32), 2e-3, np.float32)
        pressed[8:20, 8:20] = 1.2e-3
        for depth_m in (pressed, np.full((32, 32), 2e-3, np.float32)):
            yield RecordedTouch(depth_m, make_transform(np.eye(3), [0.0, 0.0, 0.02]))


class Guess(Method):
    """Puts the object under the first sensor, or fails in the way `fault` says."""

    paper: ClassVar[str] = "Anyone, anywhere"

    class Options(ComponentOptions):
        fault: str = ""
        sleep_s: float = 0.0
        tally: str = ""

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        time.sleep(self.options.sleep_s)
        if self.options.tally and not Path(self.options.tally).exists():
            Path(self.options.tally).touch()
            raise ValueError("the first call fails")
        assert all(touch.T_sensor_object is None for touch in touches), "the truth is not hidden"
        T = np.asarray(touches[0].T_base_sensor) @ make_transform(np.eye(3), [0.0, 0.0, 0.02])
        one = np.ones(1)
        match self.options.fault:
            case "":
                return ScoredPoses(T[None], one)
            case "no pose":
                raise TouchError("nothing fits")
            case "error":
                raise ValueError("nothing\nworks")
            case "nothing":
                return None  # type: ignore[return-value]
            case "mirror":
                return ScoredPoses((T @ np.diag([-1.0, 1.0, 1.0, 1.0]))[None], one)
        raise AssertionError


class Oracle(Method):
    """Knows the true poses of all touches drawn in this process, and states two poses with probabilities."""

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        known = Sketch.drawn.get(touches[0].contact_shape.depth_m.tobytes())
        if known is None:
            raise LookupError("the oracle does not know this touch" + 5000 * "!")
        T = np.asarray(touches[0].T_base_sensor) @ known
        aside = T @ make_transform(np.eye(3), [0.02, 0.0, 0.0])
        p = np.array([0.75, 0.25])
        return ScoredPoses(np.stack([T, aside]), p, p, "certain")
