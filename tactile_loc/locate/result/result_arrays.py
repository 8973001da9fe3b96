"""The arrays of `result.npz`: the posterior, the surface and the contact shapes of a result. SI units.

The file has plain arrays and JSON texts. Nothing is pickled.
"""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh, check_surface
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.json_keys import read_keys
from tactile_loc.io.meshes.mesh_files import simplify_mesh
from tactile_loc.io.streams.records import hash_document
from tactile_loc.locate.result.result_json import AGAIN, SCHEMA_VERSION, TOUCH
from tactile_loc.store.arrays import load_npz
from tactile_loc.store.files import parse_json, write_atomically

NAME = "result.npz"
MOST_POSES = 20_000
MOST_FACES = 50_000

Arrays = dict[str, NDArray[Any]]


def reduce_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Return the surface that files and reports keep: decimated if it has more than MOST_FACES faces."""
    return mesh if len(mesh.faces) <= MOST_FACES else simplify_mesh(mesh, MOST_FACES)


def find_most_probable(posterior: PosePosterior, most: int = MOST_POSES) -> Ints:
    """Return the indices (K,) of the most probable poses, at most `most`, without those of probability 0."""
    top = posterior.top(most)
    return top[np.isfinite(posterior.log_p[top])]


def write_arrays(path: Path, arrays: Arrays, document: dict[str, Any]) -> Path:
    """Write the arrays of a result as .npz, atomically, and return the path. `document` is that of its result.json.

    Raises OutputError.
    """
    head = {"schema_version": np.array(SCHEMA_VERSION), "result_sha256": np.array(hash_document(document))}
    stored: Arrays = {**head, **arrays}
    return write_atomically(path, lambda temporary: np.savez_compressed(temporary, allow_pickle=False, **stored))


def read_arrays(path: Path, document: dict[str, Any]) -> Arrays:
    """Read the arrays of a result, whose result.json has the `document`. Raises ResultError if that fails."""
    if not path.is_file():
        raise ResultError(f"{path} is missing; copy it from where result.json was made, or run `tactile-loc run` again")
    try:
        stored = load_npz(path)
    except (OSError, ValueError) as error:
        raise ResultError(f"{path} is damaged: it cannot be read as .npz; {AGAIN}") from error
    version = stored.pop("schema_version", None)
    if str(version) != str(SCHEMA_VERSION):
        raise ResultError(f"{path} has version {version}, but this tactile-loc reads version {SCHEMA_VERSION}; {AGAIN}")
    if str(stored.pop("result_sha256", "")) != hash_document(document):
        raise ResultError(f"{path} belongs to another result than the .json file beside it; {AGAIN}")
    return stored


def pack_arrays(posterior: PosePosterior, touches: Iterable[Touch], left_out: Iterable[Touch] = ()) -> Arrays:
    """Return the arrays of a result as stored in the file; docs/reports.md lists them."""
    kept, mesh = find_most_probable(posterior), reduce_mesh(posterior.grid.metric.object.mesh)
    arrays: Arrays = {
        "vertices_m": mesh.vertices_m.astype(np.float32),
        "faces": mesh.faces.astype(np.int32),
        "T_sensor_object": posterior.grid.T_sensor_object[kept].astype(np.float32),
        "log_p": posterior.log_p[kept].astype(np.float32),
    }
    if posterior.log_train is not None:
        arrays["log_train"] = posterior.log_train[kept].astype(np.float32)
    for kind, some in (("touch", touches), ("left_out", left_out)):
        for number, touch in enumerate(some):
            arrays |= {f"{kind}_{number}_{name}": value for name, value in _pack_touch(touch).items()}
    return arrays


def _pack_touch(touch: Touch) -> Arrays:
    camera = {f.name: getattr(touch.geometry, f.name) for f in dataclasses.fields(touch.geometry)}
    optional = {"observed": camera.pop("observed"), "relief_m": camera.pop("relief_m"), "image": touch.image}
    camera["gel"], optional["touching"] = touch.geometry.gel.describe(), touch.contact_shape.touching
    return {
        "depth_m": touch.contact_shape.depth_m,
        "press_depth_m": np.array(touch.press_depth_m),
        "geometry": np.array(json.dumps(camera)),
        **{name: value for name, value in optional.items() if value is not None},
    }


def unpack_mesh(arrays: Arrays) -> TriangleMesh:
    """Return the surface. Raises KeyError, ValueError or ObjectError for invalid arrays."""
    mesh = TriangleMesh(_read_numbers(arrays, "vertices_m"), _read_numbers(arrays, "faces").astype(np.int64))
    if mesh.vertices_m.shape[1:] != (3,) or mesh.faces.shape[1:] != (3,):
        raise ValueError("its vertices or faces do not have three columns")
    if not mesh.faces.size or mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices_m):
        raise ValueError("it has no surface")
    check_surface(mesh, "its surface")
    return mesh


def unpack_posterior(arrays: Arrays, obj: ObjectModel, touches: int, elsewhere: float) -> PosePosterior:
    """Return the posterior over the stored poses, the most probable first.

    `touches` and `elsewhere` are as in PosePosterior. Raises KeyError, ValueError or GridError for invalid arrays.
    """
    T, log_p = _read_numbers(arrays, "T_sensor_object"), _read_numbers(arrays, "log_p")
    if T.shape != (*log_p.shape, 4, 4) or log_p.size == 0:
        raise ValueError("its poses and log-probabilities differ in number")
    log_train = _read_numbers(arrays, "log_train") if "log_train" in arrays else None
    return PosePosterior(PoseGrid(T, PoseMetric(obj)), log_p, log_train, touches, elsewhere)


def unpack_touches(arrays: Arrays, kind: str, documents: list[Any]) -> tuple[Touch, ...]:
    """Return touches from their documents and the arrays whose names start with `kind` and their number.

    Raises KeyError, ValueError, TypeError or TouchError for invalid or missing arrays.
    """
    count = sum(name.startswith(f"{kind}_") and name.endswith("_geometry") for name in arrays)
    if count != len(documents):
        raise ValueError(f"{NAME} has {count} touches, but result.json has {len(documents)}")
    heads = [f"{kind}_{number}_" for number in range(count)]
    parts = [{k.removeprefix(head): v for k, v in arrays.items() if k.startswith(head)} for head in heads]
    return tuple(_unpack_touch(*pair) for pair in zip(documents, parts, strict=True))


def _unpack_touch(document: Any, arrays: Arrays) -> Touch:
    keys = read_keys(TOUCH, document, "touch")
    geometry = _unpack_geometry(arrays)
    shape = ContactShape(
        _read_numbers(arrays, "depth_m").astype(np.float32),
        float(arrays["press_depth_m"]),
        keys["indentation_m"],
        keys["indentation_std_m"],
        keys["depths_known"],
        arrays.get("touching"),
    )
    image = arrays.get("image")
    if shape.depth_m.shape != geometry.shape:
        raise ValueError("a contact shape does not have the sensor's size")
    if not (shape.touching is None or (shape.touching.shape == geometry.shape and shape.touching.dtype == bool)):
        raise ValueError("the pixels that touch the object are not a mask of the sensor's size")
    if not (image is None or (image.ndim == 3 and image.dtype == np.uint8)):
        raise ValueError("a touch's image has the wrong shape")
    T_base_sensor, T_true = (
        None if keys[k] is None else np.array(keys[k]) for k in ("T_base_sensor", "T_sensor_object")
    )
    touch = Touch(shape, geometry, keys["name"], T_base_sensor, T_true, image=image)
    stds = {name: keys[name] for name in ("T_base_sensor_std_m", "T_base_sensor_std_rad") if keys[name] is not None}
    return dataclasses.replace(touch, **stds)


def _unpack_geometry(arrays: Arrays) -> SensorGeometry:
    camera = parse_json(str(arrays["geometry"]))
    if camera["rectangle_m"] is not None:
        camera["rectangle_m"] = tuple(camera["rectangle_m"])
    camera["gel"] = Gel.of_description(camera["gel"])
    return SensorGeometry(**camera, observed=arrays.get("observed"), relief_m=arrays.get("relief_m"))


def _read_numbers(arrays: Arrays, name: str) -> Floats:
    """Return the array `name` as floats. Raises KeyError, or ValueError if its values are not finite numbers."""
    values = arrays[name]
    if values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise ValueError(f"{name} holds values that are not finite numbers")
    return values.astype(np.float64)
