"""Real touches of a DIGIT that slides over ten YCB objects, with poses by motion capture: YCB-Slide.

Suresh et al., MidasTouch: Monte-Carlo inference over distributions across sliding touch, CoRL 2022. The folder is that
of the download: `real/OBJECT/dataset_N` with `frames` and `synced_data.npy`, `real/OBJECT/alignment.npy`, and
`obj_models/OBJECT/nontextured.stl`. The poses are those of the documentation: the object's pose is removed from that of
the DIGIT, whose camera looks along -z, and the translation is corrected by the alignment. The set has no presses of a
ball, so the sensor is a calibrated sensor of the user.
"""

import pickle
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any, ClassVar

import numpy as np
import PIL.Image
from pydantic import Field
from scipy.spatial.transform import Rotation
from tactile_loc import load_object
from tactile_loc.plugin import ComponentOptions, ConfigError, ObjectModel, Poses, TouchError
from tactile_loc.plugin.helpers import make_transform

from tactile_loc_benchmark.interfaces import Image, RecordedSource, RecordedTouch

CAMERA_M = 22e-3  # distance of the gel from the DIGIT's tracked frame, along the camera's view
STANDOFF_M = 10e-3  # distance of the gel from the origin of the sensor frame
COMPARED = 40  # largest number of frames from which the median is taken
ALLOWED = {
    (module, name)
    for part in ("core", "_core")
    for module, name in ((f"numpy.{part}.multiarray", "_reconstruct"), (f"numpy.{part}.multiarray", "scalar"))
} | {("numpy", "ndarray"), ("numpy", "dtype")}


class YcbSlide(RecordedSource):
    """Frames of the sliding DIGIT that differ most from the median frame."""

    licence: ClassVar[str] = "CC BY-SA 4.0"

    class Options(ComponentOptions):
        """The folder of the recordings, and the sensor that reads them."""

        data: str = Field(description="folder of the download, with `real` and `obj_models`")
        sensor: str = Field(description="folder of a calibrated DIGIT")
        touches: int = Field(default=20, ge=1, description="number of frames of each recording")
        turn_deg: float = Field(default=0.0, description="turn of the images about the gel's normal, degrees")

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the table of the calibrated sensor."""
        return {"name": "calibrated", "path": str(Path(self.options.sensor).expanduser())}

    def find_objects(self) -> Mapping[str, ObjectModel]:
        """Return the objects that have recordings. Raises ConfigError if there are none."""
        names = sorted(path.parent.name for path in self._root.glob("real/*/alignment.npy"))
        if not names:
            raise ConfigError(
                f"there is no {self._root}/real/OBJECT/alignment.npy; state the folder of YCB-Slide, `data`"
            )
        meshes = self._root / "obj_models"
        return {name: load_object(meshes / name / "nontextured.stl", "m", "auto", name=name) for name in names}

    def read_touches(self, name: str) -> Iterable[RecordedTouch]:
        """Return the touches of an object. Raises TouchError for a damaged file."""
        alignment = np.load(self._root / "real" / name / "alignment.npy", allow_pickle=False)
        for recording in sorted((self._root / "real" / name).glob("dataset_*")):
            poses = read_poses(recording / "synced_data.npy", name, alignment)
            frames = sorted((recording / "frames").glob("*.jpg"))
            if len(frames) != len(poses):
                raise TouchError(f"{recording} has {len(frames)} frames but {len(poses)} poses; download it again")
            for number in choose_touches(frames, self.options.touches):
                T = place_sensor(poses[number], self.options.turn_deg)
                yield RecordedTouch(read_frame(frames[number]), T, f"{recording.name} {frames[number].stem}")

    @property
    def _root(self) -> Path:
        return Path(self.options.data).expanduser()


def read_frame(path: Path) -> Image:
    """Return a frame (H, W, 3)."""
    return np.asarray(PIL.Image.open(path).convert("RGB"))


def choose_touches(frames: list[Path], count: int) -> list[int]:
    """Return the numbers of `count` frames, evenly among those that differ most from the median frame."""
    small = [np.asarray(PIL.Image.open(path).convert("RGB").resize((32, 32)), np.float32) for path in frames]
    median = np.median(small[:: max(1, len(small) // COMPARED)], axis=0)
    change = np.array([np.abs(one - median).mean() for one in small])
    pressed = np.flatnonzero(change >= (change.min() + change.max()) / 2)
    return pressed[np.unique(np.linspace(0, len(pressed) - 1, count).round().astype(int))].tolist()


def read_poses(path: Path, name: str, alignment: Poses) -> Poses:
    """Return the gel's poses `T_object_gel` (N, 4, 4), metres, of a recording. Raises TouchError for a damaged file.

    The frame of the gel is that of the documentation: z points into the sensor, away from the object.
    """
    try:
        bodies = read_pickled(path)["poses"]
        T_world_digit, T_world_object = (make_transforms(bodies[key]) for key in ("DIGIT", name))
    except (OSError, KeyError, ValueError, TypeError, pickle.UnpicklingError) as error:
        raise TouchError(f"{path} cannot be read as poses of YCB-Slide ({error}); download it again") from error
    T = np.linalg.inv(T_world_object) @ T_world_digit @ make_transform(np.eye(3), [0, 0, -CAMERA_M])
    T[:, :3, 3] += np.asarray(alignment)[:3, 3]
    return np.asarray(T)


def make_transforms(position_quaternion: Any) -> Poses:
    """Return transforms (N, 4, 4) of positions, metres, and quaternions x, y, z, w (N, 7)."""
    values = np.asarray(position_quaternion, np.float64)
    T = np.tile(np.eye(4), (len(values), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_quat(values[:, 3:]).as_matrix(), values[:, :3]
    return T


def place_sensor(T_object_gel: Poses, turn_deg: float) -> Poses:
    """Return `T_sensor_object` (4, 4), metres, of a gel; the sensor looks along +z, and its images are turned."""
    turned = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    T_gel_sensor = make_transform(np.diag([1.0, -1.0, -1.0]) @ turned, [0, 0, STANDOFF_M])
    return np.asarray(np.linalg.inv(T_object_gel @ T_gel_sensor))


class _ArraysOnly(pickle.Unpickler):
    """Reads pickles of arrays, texts, numbers and their collections. Anything else is refused, because it may run."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in ALLOWED:
            raise pickle.UnpicklingError(f"it holds {module}.{name}")
        return super().find_class(module, name)


def read_pickled(path: Path) -> dict[str, Any]:
    """Return the dictionary in an .npy file. Raises UnpicklingError if it holds more than arrays, texts and numbers."""
    with path.open("rb") as file:
        _skip_header(file)
        found: Any = _ArraysOnly(file).load()
    values = found.item()
    if not isinstance(values, dict):
        raise ValueError("it holds no dictionary")
    return values


def _skip_header(file: IO[bytes]) -> None:
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    read(file)
