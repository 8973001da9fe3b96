"""One visitor's work on the page, without the page: an object, a sensor, a virtual finger, touches and a result."""

import hashlib
import itertools
import shutil
import tempfile
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from tactile_loc import (
    DEMO_OBJECTS,
    ContactShape,
    GaussianPrior,
    Localization,
    Localizer,
    ObjectModel,
    PoseModes,
    RatedApproach,
    RunConfig,
    SensorGeometry,
    Touch,
    Units,
    choose_next_touch,
    draw_approaches_to_modes,
    localize_together,
    read_observations,
)
from tactile_loc.plugin import ConfigError, Scene, TouchError
from tactile_loc.plugin.helpers import make_transform, rotation_about

from tactile_loc_app.calibrator import Calibrator
from tactile_loc_app.chosen_camera import ChosenCamera
from tactile_loc_app.errors import AppError
from tactile_loc_app.export import write_export
from tactile_loc_app.page.task_progress import ShowProgress
from tactile_loc_app.shared_localizers import SharedLocalizers
from tactile_loc_app.uploads import is_archive, unpack_upload, write_upload
from tactile_loc_app.virtual_finger import Pose, Press, make_touch, press_finger

APPROACHES = 60  # approaches from which the next touch is chosen
LIST = "touches.toml"  # list of touches in an archive
UPPER, TILT_RAD = 0.1, np.radians(35)  # upper part of an object, share of its height, and tilt of the first finger
PRESS = 0.5  # press of the first finger, share of the sensor's maximal depth


@dataclass(frozen=True)
class Judged:
    """The verdict on the first `touches` touches, and the probability, 0 to 1, of a right first pose, if known."""

    touches: int
    verdict: str
    probability_within: float | None
    explanations: int


class Session:
    """The state of one visitor. The object rests with its frame at the base frame, in which touches have their poses.

    `press_depth_m` is the press of the virtual finger at `T_base_sensor`. `touches` are located together. A new object
    or a new sensor removes the touches, because they belong to both. Uploaded files are kept in `folder`, until the
    session is closed. `mesh_file` and `touch_file` are the latest ones, which can be read again.
    """

    def __init__(self, localizers: SharedLocalizers, config: RunConfig | None = None, seed: int = 0) -> None:
        """Begin with the object and the sensor that `config` names. Raises TactileLocError if they cannot be used."""
        self.localizers, self.begin_s = localizers, time.monotonic()
        self.rng = np.random.default_rng(seed)
        self.folder = Path(tempfile.mkdtemp(dir=localizers.folder, prefix="visitor-"))
        self.inbox = self.folder / "touches"
        self.inbox.mkdir()
        self.calibrator = Calibrator(self.folder / "calibration", localizers.store)
        self.camera = ChosenCamera()
        self.touch_file: Path | None = None
        self._begin(localizers.get(config or RunConfig()))
        self.mesh_file = Path(self.localizer.config.object.path) if self.is_own_object else None
        self._awaits_unit = False

    def _begin(self, localizer: Localizer) -> None:
        self.localizer = localizer
        self.prior: GaussianPrior | None = None
        self.T_base_sensor = place_at_edge(localizer.object, localizer.scene)
        self.press_depth_m = PRESS * localizer.scene.geometry.max_depth_m
        self.clear_touches()

    def close(self) -> None:
        """Close the camera, end a calibration, and delete the visitor's files."""
        self.calibrator.stop()
        self.camera.close()
        self.localizers.forget(self.folder)
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def object(self) -> ObjectModel:
        """The object that is touched."""
        return self.localizer.object

    @property
    def is_own_object(self) -> bool:
        """Whether the object is a mesh file, and no demo object."""
        return self.localizer.config.object.path not in DEMO_OBJECTS

    @property
    def scene(self) -> Scene:
        """The object and the sensor, which is not pressed."""
        return self.localizer.scene

    # object and sensor

    def load_object(self, path: str | Path, units: Units = "auto") -> None:
        """Take another object: a mesh file or a demo object. Raises TactileLocError if it cannot be used."""
        self._choose(object={"path": str(path), "units": units})
        self._awaits_unit = False

    def upload_object(self, name: str, content: bytes, units: Units = "auto") -> None:
        """Take another object from the content of a mesh file.

        Raises TactileLocError if it cannot be used. Then `choose_units` reads it in another unit.
        """
        own = self.folder / "meshes" / hashlib.sha256(content).hexdigest()[:16]
        self.mesh_file = write_upload(own, name, content)
        self._awaits_unit = True
        self.load_object(self.mesh_file, units)

    def choose_units(self, units: Units) -> bool:
        """Read the own mesh file again in another unit, and return True; return False if nothing changes.

        It is the object, or it could not be used when it was uploaded. Raises TactileLocError if it cannot be used.
        """
        chosen, path = self.localizer.config.object, self.mesh_file
        if path is None or not (self.is_own_object or self._awaits_unit):
            return False
        if (chosen.path, chosen.units) == (str(path), units):
            return False
        self.load_object(path, units)
        return True

    def choose_sensor(self, sensor: str) -> None:
        """Take another sensor: a name, a .toml file or a calibration folder. Raises TactileLocError for bad input."""
        self._choose(sensor=sensor)

    def _choose(self, **settings: Any) -> None:
        chosen = self.localizer.config.model_dump(include={"object", "sensor"})
        self._begin(self.localizers.get(RunConfig.from_dict({**chosen, **settings}, "the page")))

    # the virtual finger

    def press(self, T_base_sensor: Pose, depth_m: float) -> Press:
        """Press the finger `depth_m` metres deep from the pose (4, 4), metres; see `press_finger`."""
        self.T_base_sensor, self.press_depth_m = T_base_sensor, depth_m
        return press_finger(self.scene, T_base_sensor, depth_m)

    # touches

    def clear_touches(self) -> None:
        """Remove all touches and the result."""
        self.touches: tuple[Touch, ...] = ()
        self.result: Localization | None = None
        self.history: tuple[Judged, ...] = ()

    def remove_touch(self, number: int) -> None:
        """Remove a touch, numbered from 0, and the result, to which it belonged."""
        left = tuple(touch for k, touch in enumerate(self.touches) if k != number)
        self.clear_touches()
        self.touches = left

    def add_touch(self, noise: str = "none") -> Touch:
        """Add the touch of the virtual finger, and return it. Raises TactileLocError as `make_touch` does."""
        taken = {touch.name for touch in self.touches}
        name = next(name for k in itertools.count(1) if (name := f"touch-{k}") not in taken)
        touch = make_touch(self.scene, self.T_base_sensor, self.press_depth_m, name, noise, self.rng)
        self.touches = (*self.touches, touch)
        return touch

    def read_touch_file(
        self, name: str, content: bytes, unit: str | None = None, kind: str | None = None
    ) -> tuple[Touch, ...]:
        """Add the touch in the content of a file, and return the added touches.

        The file is a contact shape, a photo of a calibrated sensor, a list of touches (.toml), or a zip archive of a
        list LIST with its files. A list replaces all touches. Without an archive, it names files that were uploaded
        before. Raises TactileLocError for bad input. Then `read_touches_again` needs no second upload.
        """
        self.touch_file = (
            self._unpack_list(name, content) if is_archive(name) else write_upload(self.inbox, name, content)
        )
        return self.read_touches_again(unit, kind)

    def read_touches_again(self, unit: str | None = None, kind: str | None = None) -> tuple[Touch, ...]:
        """Add the touches in the latest uploaded file, for the present object and sensor, and return them.

        Raises TactileLocError for bad input.
        """
        path = self.touch_file
        if path is None:
            raise AppError("there is no file of touches yet; upload one")
        if path.suffix.lower() == ".toml":
            read = self._read_list(path)
            self.clear_touches()
        else:
            read = (self.localizer.read_touch(path, unit, None, kind),)
        self.touches = (*self.touches, *read)
        return read

    def _unpack_list(self, name: str, content: bytes) -> Path:
        """Unpack an archive into an own folder, and return the path of its list. Raises AppError."""
        folder = Path(tempfile.mkdtemp(dir=self.folder, prefix="archive-"))
        lists = [path for path in unpack_upload(folder, name, content) if path.name == LIST]
        if len(lists) != 1:
            raise AppError(f"{name} holds {len(lists)} files {LIST}; it must hold one, with the touches that it names")
        return lists[0]

    def _read_list(self, path: Path) -> tuple[Touch, ...]:
        """Read a list of uploaded touches of the chosen sensor. Raises TactileLocError for bad input."""
        _require_own_files(path)
        observations = read_observations(self.localizer, path)
        if any(localizer is not self.localizer for localizer, _ in observations):
            raise TouchError("the list names another sensor than the chosen one; remove its `sensor`, or choose it")
        return tuple(touch for _, touch in observations)

    def take_camera_touch(self, source: str) -> Touch:
        """Add the touch in the newest frame of a camera, a video or a folder, and return it: see `ChosenCamera`.

        Raises AppError if there is no frame, and TouchError if the sensor cannot read it as a touch.
        """
        touch = self.camera.take(source).read_touch(self.localizer.sensor)
        self.touches = (*self.touches, touch)
        return touch

    # answers

    def set_prior(self, T_base_object: Pose | None, translation_std_m: float, rotation_std_rad: float) -> None:
        """Expect the object near a pose (4, 4), metres, in the base frame; None means that nothing is known.

        Raises ConfigError if a standard deviation is not positive.
        """
        self.prior = None
        if T_base_object is not None:
            self.prior = GaussianPrior(T_base_object, translation_std_m, rotation_std_rad, self.object.symmetry)

    def locate(self, show: ShowProgress | None = None) -> Localization:
        """Locate the object from all touches and the prior. The model is built at first, which takes longer.

        `show` gets the task and its share while the model is built.

        Touches that are added meanwhile do not count. Raises TactileLocError if there is no touch, or no pose fits.
        """
        localizer, touches = self.localizer, self.touches
        if not touches:
            raise TouchError("there is no touch yet; add a touch first")
        prior = None if self.prior is None else self.prior.view_from(_require_pose(touches[0]))
        with self.localizers.use(localizer, show):
            found = localize_together([(localizer, touch) for touch in touches], prior)
        if touches == self.touches[: len(touches)] and localizer is self.localizer:
            self._keep(found, len(touches))
        return found

    def _keep(self, found: Localization, count: int) -> None:
        judged = Judged(count, str(found.verdict), found.probability_within(), len(found.equal_explanations))
        self.result = found
        self.history = (*(one for one in self.history if one.touches < count), judged)

    def export(self, folder: Path) -> list[Path]:
        """Write the result, its report, and a Python script with all its files; return the paths: see `write_export`.

        Raises AppError without a result, and AppError if a file cannot be written.
        """
        return write_export(folder, self.localizer, self.require_result(), self.prior)

    def require_result(self) -> Localization:
        """Return the result. Raises AppError if the object was not located yet."""
        if self.result is None:
            raise AppError("there is no result yet; locate the object first")
        return self.result

    def predict(self, number: int, touch: int) -> tuple[ContactShape, ContactShape, SensorGeometry]:
        """Return the observed contact shape of a touch, the one that a hypothesis predicts, and their geometry.

        Hypotheses and touches are numbered from 0. Raises AppError without a result.
        """
        found = self.require_result()
        view = found.make_views()[touch]
        T = view.T_sensor_first @ found.hypotheses[number].T_sensor_object
        depth_m = view.scene.render_what_touch_shows(T[None], view.touch)[0]
        return view.touch.contact_shape, ContactShape(depth_m, view.touch.press_depth_m), view.touch.geometry

    def suggest_next(self) -> RatedApproach:
        """Return the approach, of some around the object, that tells most about its pose, and touches it.

        If all of them miss the object, it is the first one. Raises AppError without a result, and ConfigError if no
        approach is within reach.
        """
        modes = PoseModes.of(self.require_result())
        ranked = choose_next_touch(modes, draw_approaches_to_modes(modes, APPROACHES, self.rng)).ranked
        pressed = ((one, press_finger(self.scene, one.approach.T_base_sensor, self.press_depth_m)) for one in ranked)
        return next((one for one, press in pressed if press.touches), ranked[0])


def place_at_edge(obj: ObjectModel, scene: Scene) -> Pose:
    """Return the pose `T_base_sensor` (4, 4), metres, of a finger above an edge of the object's upper side.

    An edge tells more than a face. Of the upper vertices, the finger is above the one farthest from the middle, and
    tilted away from it.
    """
    corners = obj.mesh.corners_m
    low_m, high_m = corners[:, 2].min(), corners[:, 2].max()
    upper = corners[corners[:, 2] > high_m - UPPER * (high_m - low_m)]
    middle = corners.mean(axis=0)
    away = (upper - middle)[:, :2]
    edge = upper[np.linalg.norm(away, axis=1).argmax()]
    outwards = edge[:2] - middle[:2]
    x, y = outwards / max(np.linalg.norm(outwards), 1e-9)
    R = rotation_about([-y, x, 0], TILT_RAD) @ rotation_about([1, 0, 0], np.pi)
    return make_transform(R, edge - scene.geometry.surface_m * R[:, 2])


def list_poses(found: Localization) -> Sequence[Pose]:
    """Return the hypotheses' poses (4, 4), metres, in the base frame or, if unknown, the first touch's sensor frame."""
    return [h.T_sensor_object if h.T_base_object is None else h.T_base_object for h in found.hypotheses]


def _require_pose(touch: Touch) -> Pose:
    if touch.T_base_sensor is None:
        raise TouchError(f"{touch.name} has no sensor pose, so the prior cannot be used; remove the prior")
    return touch.T_base_sensor


def _require_own_files(path: Path) -> None:
    """Raise ConfigError if a list of touches names a file outside its folder, or a sensor by a path."""
    try:
        values = tomllib.loads(path.read_text("utf-8-sig"))
    except ValueError as error:
        raise ConfigError(f"{path.name} cannot be read as TOML ({error}); correct the list") from error
    tables = values.get("touch")
    tables = [values, *(tables if isinstance(tables, list) else [])]
    for table in (table for table in tables if isinstance(table, dict)):
        for key in ("path", "mount"):
            name = table.get(key)
            if isinstance(name, str) and (PurePath(name).is_absolute() or ".." in PurePath(name).parts):
                raise ConfigError(f"the list names the file {name!r}; upload the file, and give only its name")
        sensor = table.get("sensor")
        if isinstance(sensor, str) and PurePath(sensor).name != sensor:
            raise ConfigError(
                f"the list names the sensor {sensor!r}; remove `sensor`, and choose the sensor on the page"
            )
