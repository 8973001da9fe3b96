"""The file `result.npz`: the arrays of a result that a report needs and `result.json` lacks. SI units.

The file has the posterior, the surface and the contact shapes as plain arrays and JSON texts. Nothing is pickled.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import TriangleMesh, check_surface
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import ResultError, TactileLocError
from tactile_loc.core.sensing.gel import RIGID, Gel
from tactile_loc.core.sensing.scene import View, relate_sensors
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.images import load_npz
from tactile_loc.io.meshes.mesh_files import simplify_mesh
from tactile_loc.io.streams.records import format_record
from tactile_loc.locate.result.result_json import Located, ResultRecord
from tactile_loc.store.files import parse_json, write_atomically

NAME = "result.npz"
SCHEMA_VERSION = 1
MOST_POSES = 20_000
MOST_FACES = 50_000
AGAIN = "run tactile-loc again with this touch alone, which writes both files"


@dataclass(frozen=True, eq=False)
class TouchArrays:
    """One touch, and the contact shapes that the hypotheses would make on its sensor.

    `T_sensor_first` (4, 4), metres, transforms from the first touch's sensor frame to the sensor frame of this touch.
    `made_m` (K, H, W) are the hypotheses' contact depths at the touch's press, metres. `image` (H, W, 3) is the photo,
    if there is one.
    """

    shape: ContactShape
    geometry: SensorGeometry
    T_sensor_first: NDArray[np.float64]
    made_m: NDArray[np.float32]
    image: NDArray[np.uint8] | None = None

    def make_shape(self, number: int) -> ContactShape:
        """Return the contact shape of hypothesis `number` (from 0)."""
        return ContactShape(self.made_m[number], self.shape.press_depth_m)


@dataclass(frozen=True, eq=False)
class ResultArrays:
    """The posterior, the surface and the touches of one result.

    `T_sensor_object` (N, 4, 4), metres, are the most probable grid poses, at most MOST_POSES, and `log_p` (N,) their
    log-probabilities, sorted. `log_train` (N,) is as in PosePosterior, if it is known. `mesh` is the surface, decimated
    if it had more than MOST_FACES faces. The touches `left_out` of the result have no shapes of hypotheses.
    """

    mesh: TriangleMesh
    T_sensor_object: Poses
    log_p: NDArray[np.float64]
    touches: tuple[TouchArrays, ...]
    left_out: tuple[TouchArrays, ...] = ()
    log_train: NDArray[np.float64] | None = None

    @property
    def mass(self) -> float:
        """The total probability of the kept poses, 0 to 1."""
        return float(np.exp(self.log_p).sum())

    @property
    def weights(self) -> NDArray[np.float64]:
        """Probabilities (N,) of the kept poses, scaled to sum to one."""
        p = np.exp(self.log_p - self.log_p.max())
        return np.asarray(p / p.sum())


def gather_arrays(views: Sequence[View], localization: Located) -> ResultArrays:
    """Gather the arrays of a localisation; `views` are those of its touches, in order."""
    poses = np.stack([h.T_sensor_object for h in localization.hypotheses])
    posterior, log_train = localization.posterior, localization.posterior.log_train
    touches = []
    for view in views:
        made_m = view.scene.render_what_touch_shows(view.T_sensor_first @ poses, view.touch)
        touches.append(_gather_touch(view.touch, view.T_sensor_first, made_m))
    left_out = [
        _gather_touch(touch, relate_sensors(localization.touch, touch), np.empty((0, *touch.geometry.shape)))
        for touch in localization.left_out
    ]
    kept = find_most_probable(posterior)
    mesh = reduce_mesh(views[0].scene.object.mesh)
    return ResultArrays(
        TriangleMesh(_round(mesh.vertices_m), mesh.faces), _round(posterior.grid.T_sensor_object[kept]),
        _round(posterior.log_p[kept]), tuple(touches), tuple(left_out),
        None if log_train is None else _round(log_train[kept]),
    )  # fmt: skip


def _gather_touch(touch: Touch, T_sensor_first: NDArray[np.float64], made_m: NDArray[Any]) -> TouchArrays:
    return TouchArrays(touch.contact_shape, touch.geometry, T_sensor_first, made_m.astype(np.float32), touch.image)


def _round(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round values to the file's precision, so that a report is the same before and after they are stored."""
    return values.astype(np.float32).astype(np.float64)


def reduce_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Return the surface that reports draw: decimated if it has more than MOST_FACES faces."""
    return mesh if len(mesh.faces) <= MOST_FACES else simplify_mesh(mesh, MOST_FACES)


def find_most_probable(posterior: PosePosterior, most: int = MOST_POSES) -> NDArray[np.int64]:
    """Return the indices (K,) of the most probable poses, at most `most`, without those of probability 0."""
    top = posterior.top(most)
    return top[np.isfinite(posterior.log_p[top])]


def write_arrays(path: Path, arrays: ResultArrays, record: ResultRecord) -> Path:
    """Write the arrays of a record's result as .npz, atomically; return the path. Raises OutputError."""
    head = {"schema_version": np.array(SCHEMA_VERSION), "result_sha256": np.array(hash_record(record))}
    stored: dict[str, Any] = {**head, **pack_arrays(arrays)}
    return write_atomically(path, lambda temporary: np.savez_compressed(temporary, allow_pickle=False, **stored))


def read_arrays(path: Path, record: ResultRecord) -> ResultArrays:
    """Read the arrays of a record. Raises ResultError if the file cannot be used."""
    if not path.is_file():
        raise ResultError(f"{path} is missing; copy it from where result.json was made, or run `tactile-loc run` again")
    try:
        stored = load_npz(path)
    except (OSError, ValueError) as error:
        raise ResultError(f"{path} is damaged: it cannot be read as .npz; {AGAIN}") from error
    version = stored.pop("schema_version", None)
    if version is None or str(version) != str(SCHEMA_VERSION):
        raise ResultError(f"{path} has version {version}, but this tactile-loc reads version {SCHEMA_VERSION}; {AGAIN}")
    if str(stored.pop("result_sha256", "")) != hash_record(record, read=True):
        raise ResultError(f"{path} belongs to another result than the .json file beside it; {AGAIN}")
    try:
        arrays = unpack_arrays(stored)
    except (KeyError, ValueError, TypeError, TactileLocError) as error:
        raise ResultError(f"{path} is damaged or incomplete ({error}); {AGAIN}") from error
    if any(len(touch.made_m) != len(record.hypotheses) for touch in arrays.touches):
        raise ResultError(f"{path} is incomplete: it lacks the contact shapes of some hypotheses; {AGAIN}")
    return arrays


def hash_record(record: ResultRecord, read: bool = False) -> str:
    """Return the SHA-256 (hex) of a record's content, which shows whether a .json and an .npz file belong together.

    If the record was `read` from a file, only the keys in the file count, because older files lack some.
    """
    return hashlib.sha256(format_record(record, exclude_unset=read).encode()).hexdigest()


def pack_arrays(result: ResultArrays) -> dict[str, NDArray[Any]]:
    """Return the arrays as stored in the file; docs/reports.md lists them."""
    arrays: dict[str, Any] = {
        "vertices_m": result.mesh.vertices_m.astype(np.float32), "faces": result.mesh.faces.astype(np.int32),
        "T_sensor_object": result.T_sensor_object.astype(np.float32), "log_p": result.log_p.astype(np.float32),
    }  # fmt: skip
    if result.log_train is not None:
        arrays["log_train"] = result.log_train.astype(np.float32)
    for kind, touches in (("touch", result.touches), ("left_out", result.left_out)):
        for number, touch in enumerate(touches):
            arrays |= {f"{kind}_{number}_{name}": value for name, value in _pack_touch(touch).items()}
    return arrays


def unpack_arrays(arrays: dict[str, NDArray[Any]]) -> ResultArrays:
    """Return the result from stored arrays. Raises KeyError, ValueError or TypeError for invalid arrays."""
    mesh = TriangleMesh(_read_numbers(arrays, "vertices_m"), _read_numbers(arrays, "faces").astype(np.int64))
    if mesh.vertices_m.shape[1:] != (3,) or mesh.faces.shape[1:] != (3,):
        raise ValueError("its vertices or faces do not have three columns")
    touches, left_out = (_unpack_touches(arrays, kind) for kind in ("touch", "left_out"))
    if not touches or not mesh.faces.size or mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices_m):
        raise ValueError("it has no touch or no surface")
    check_surface(mesh, "its surface")
    T, log_p = _read_numbers(arrays, "T_sensor_object"), _read_numbers(arrays, "log_p")
    if T.shape != (*log_p.shape, 4, 4) or log_p.size == 0:
        raise ValueError("its poses and log-probabilities differ in number")
    log_train = _read_numbers(arrays, "log_train") if "log_train" in arrays else None
    return ResultArrays(mesh, T, log_p, touches, left_out, log_train)


def _unpack_touches(arrays: dict[str, NDArray[Any]], kind: str) -> tuple[TouchArrays, ...]:
    """Return the touches whose arrays' names start with `kind` and their number."""
    count = sum(name.startswith(f"{kind}_") and name.endswith("_geometry") for name in arrays)
    heads = [f"{kind}_{number}_" for number in range(count)]
    return tuple(
        _unpack_touch({k.removeprefix(head): v for k, v in arrays.items() if k.startswith(head)}) for head in heads
    )


def _pack_touch(touch: TouchArrays) -> dict[str, NDArray[Any]]:
    camera = {f.name: getattr(touch.geometry, f.name) for f in dataclasses.fields(touch.geometry)}
    observed, relief_m = camera.pop("observed"), camera.pop("relief_m")
    camera["gel"] = touch.geometry.gel.describe()
    optional = {"observed": observed, "relief_m": relief_m, "image": touch.image}
    return {
        "depth_m": touch.shape.depth_m, "press_depth_m": np.array(touch.shape.press_depth_m),
        "geometry": np.array(json.dumps(camera)), "T_sensor_first": touch.T_sensor_first, "made_m": touch.made_m,
        **{name: value for name, value in optional.items() if value is not None},
    }  # fmt: skip


def _unpack_touch(arrays: dict[str, NDArray[Any]]) -> TouchArrays:
    camera = parse_json(str(arrays["geometry"]))
    if camera["rectangle_m"] is not None:
        camera["rectangle_m"] = tuple(camera["rectangle_m"])
    camera["gel"] = Gel.of_description(camera["gel"]) if "gel" in camera else RIGID  # older files have no gel
    geometry = SensorGeometry(**camera, observed=arrays.get("observed"), relief_m=arrays.get("relief_m"))
    shape = ContactShape(_read_numbers(arrays, "depth_m").astype(np.float32), float(arrays["press_depth_m"]))
    made_m, T_sensor_first = _read_numbers(arrays, "made_m").astype(np.float32), _read_numbers(arrays, "T_sensor_first")
    if shape.depth_m.shape != geometry.shape or made_m.shape[1:] != geometry.shape:
        raise ValueError("a contact shape does not have the sensor's size")
    image = arrays.get("image")
    if T_sensor_first.shape != (4, 4) or not (image is None or (image.ndim == 3 and image.dtype == np.uint8)):
        raise ValueError("a touch's T_sensor_first or image has the wrong shape")
    return TouchArrays(shape, geometry, T_sensor_first, made_m, image)


def _read_numbers(arrays: dict[str, NDArray[Any]], name: str) -> NDArray[np.float64]:
    """Return the array `name` as floats. Raises KeyError, or ValueError if its values are not finite numbers."""
    values = arrays[name]
    if values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise ValueError(f"{name} holds values that are not finite numbers")
    return values.astype(np.float64)
