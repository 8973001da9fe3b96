"""TOML files: reading values and poses, messages about wrong keys, and writing settings."""

import json
import math
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, ValidationInfo

from tactile_loc.core.geometry.rigid import (
    Floats,
    make_transform,
    quaternion_to_rotation,
    require_near,
    require_rigid,
    require_unit,
    rotation_about,
)
from tactile_loc.core.runtime.errors import ConfigError, TactileLocError, did_you_mean, quote
from tactile_loc.core.runtime.formatting import is_unicode, show_name
from tactile_loc.store.files import read_text

Rows = list[list[float]]


def _require_rigid(rows: Rows, info: ValidationInfo) -> Rows:
    name = str(info.field_name)
    return cast(Rows, require_near(require_rigid(rows, name), name).tolist())


Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Three = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Four = Annotated[list[Finite], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Four], Field(min_length=4, max_length=4), AfterValidator(_require_rigid)]
MATRIX = "four rows of four numbers (rotation without unit, translation in metres, last row 0 0 0 1)"
POSITIVE_MM = "a positive number (mm)"
NOT_TOML = (ValueError, RecursionError)  # tomllib raises RecursionError for deep nesting
POSITIONS_M = {"xyz_mm": 1e-3, "xyz_m": 1.0}  # keys of a position, with their units in metres
ROTATIONS = ("rpy_deg", "quaternion_wxyz", "quaternion_xyzw")  # keys of a rotation


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file. Raises ConfigError when it is missing, unreadable, or not TOML."""
    try:
        if not os.path.exists(path):
            raise ConfigError(f"there is no file {path}; check the path")
        if not os.path.isfile(path):  # reading a device or a pipe may never end
            raise ConfigError(f"{path} is not a file; give a TOML file")
        return tomllib.loads(read_text(Path(path)))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror or error}); check its permissions") from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        raise ConfigError(f"{path} is not text in UTF-8 (byte 0x{byte:02x}); save it in UTF-8") from error
    except NOT_TOML as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error


def list_tables(path: Path, values: dict[str, Any], name: str, needs: str, *others: str) -> list[dict[str, Any]]:
    """Return the `[[name]]` tables of a file's values.

    Raises ConfigError when there is no such table, or when the file has keys other than `name` and `others`. The
    message contains `needs`, which describes the content of a table.
    """
    known = [name, *others]
    unknown = sorted(set(values) - set(known))
    if unknown:
        near = did_you_mean(unknown[0], known)
        raise ConfigError(f"{path} has an unknown entry {unknown[0]!r}.{near} Known: {', '.join(known)}")
    tables = values.get(name, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{name} in {path} is not a list of tables; begin each {name} with [[{name}]]")
    if not tables:
        raise ConfigError(f"{path} lists no {name}; add a table [[{name}]] with {needs} for each")
    return tables


def parse_value(text: str) -> Any:
    """Return a text's value in TOML, or the text itself if it is not TOML."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except NOT_TOML:
        return text


@contextmanager
def name_errors(
    where: object,
    model: type[BaseModel],
    values: dict[str, Any],
    what: str,
    kind: type[TactileLocError] = ConfigError,
    decisive: str = "",
) -> Iterator[None]:
    """Convert errors of the block, which reads a table, to errors of class `kind` whose message begins with `where`.

    `values` is the table, whose keys are the fields of `model`. `what` names the table in the message, which names the
    first wrong key and the allowed values. A wrong key `decisive`, on which the other keys depend, comes first. Then
    come unknown keys, and then ill-typed values. A field's description completes "key must be ...".
    """
    try:
        yield
    except ValidationError as error:
        problems = sorted(error.errors(), key=lambda p: (p["loc"][0] != decisive, p["type"] != "extra_forbidden"))
        key, fields = str(problems[0]["loc"][0]), model.model_fields
        if key not in fields:
            says = f"{what} has no key {key!r}.{did_you_mean(key, fields)} Known: {', '.join(fields)}"
        else:
            says = f"{key} = {quote(values[key])} is wrong" if key in values else f"{key} is missing"
            says += f"; it must be {fields[key].description}"
        raise kind(f"{where}: {says}") from error
    except (ValueError, TactileLocError) as error:
        raise kind(f"{where}: {error}") from error


def scale(value: float | None, factor: float = 1e-3) -> float | None:
    """Return `value` times `factor`, or None if `value` is None. The default factor converts mm to metres."""
    return None if value is None else factor * value


class PoseKeys(BaseModel):
    """The keys of a pose except the matrix, whose name depends on the frames. Unknown keys are refused.

    A field's description completes "key must be ...".
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    xyz_mm: Three | None = Field(default=None, description="[x, y, z] (mm)")
    xyz_m: Three | None = Field(default=None, description="[x, y, z] (m)")
    rpy_deg: Three | None = Field(
        default=None, description="[roll, pitch, yaw] (degrees), about the fixed axes x, y, z in this order"
    )
    quaternion_wxyz: Four | None = Field(default=None, description="[w, x, y, z], a unit quaternion, scalar first")
    quaternion_xyzw: Four | None = Field(default=None, description="[x, y, z, w], a unit quaternion, scalar last")

    def read_pose(self, matrix: str) -> Floats | None:
        """Return the pose (4, 4), metres, that a table gives by the key `matrix` or by other keys; None if it has none.

        The other keys are one of POSITIONS_M and one of ROTATIONS. For `rpy_deg`, R = Rz(yaw) Ry(pitch) Rx(roll), as in
        URDF. Raises ValueError or ConfigError for an incomplete pose, and for two poses.
        """
        given = [key for key in (*POSITIONS_M, *ROTATIONS) if getattr(self, key) is not None]
        T = to_array(getattr(self, matrix))
        if T is not None and given:
            raise ValueError(f"{matrix} is the whole pose; leave out {given[0]}")
        if T is not None or not given:
            return T
        position = _choose_key(given, tuple(POSITIONS_M), "position", matrix)
        rotation = _choose_key(given, ROTATIONS, "rotation", matrix)
        t_m = POSITIONS_M[position] * np.array(getattr(self, position), float)
        return require_near(make_transform(_read_rotation(rotation, getattr(self, rotation)), t_m), position)


def to_array(rows: Sequence[Sequence[float]] | None) -> Floats | None:
    """Return a matrix of a table as an array, or None if the table does not give it."""
    return None if rows is None else np.array(rows, float)


def name_pose_keys(matrix: str) -> str:
    """Return advice for a message: a pose is given by the key named `matrix`, or by the other keys."""
    return f"give {matrix}, or {' or '.join(POSITIONS_M)} with {' or '.join(ROTATIONS)}"


def _choose_key(given: Sequence[str], keys: Sequence[str], what: str, matrix: str) -> str:
    """Return the given key that is one of `keys`. Raises ValueError if there is none, or more than one."""
    found = [key for key in given if key in keys]
    if not found:
        add = f"add {' or '.join(keys)} to {' and '.join(given)}"
        raise ValueError(f"the pose has no {what}; {add}, or give {matrix} instead")
    if len(found) > 1:
        raise ValueError(f"the pose has more than one {what}; keep only one of {' and '.join(found)}")
    return found[0]


def _read_rotation(key: str, numbers: Sequence[float]) -> Floats:
    """Return the rotation (3, 3) that the numbers of one of ROTATIONS describe."""
    if key == "rpy_deg":
        roll, pitch, yaw = (
            rotation_about(axis, angle) for axis, angle in zip(np.eye(3), np.radians(numbers), strict=True)
        )
        return yaw @ pitch @ roll
    return quaternion_to_rotation(np.roll(require_unit(numbers, key), 1 if key == "quaternion_xyzw" else 0))


def format_toml(configuration: Mapping[str, Any]) -> str:
    """Return a resolved configuration as TOML, without unset values.

    A slot becomes one table with its name and its options. A list of tables becomes an array of tables.
    """
    plain: dict[str, Any] = {}
    tables: list[tuple[str, Mapping[str, Any]]] = []
    for name, value in configuration.items():
        if isinstance(value, Mapping):
            options = value.get("options")
            flat = {k: v for k, v in value.items() if k != "options"}
            tables.append((f"[{name}]", {**flat, **(options if isinstance(options, Mapping) else {})}))
        elif isinstance(value, (list, tuple)) and value and all(isinstance(one, Mapping) for one in value):
            tables += [(f"[[{name}]]", one) for one in value]
        else:
            plain[name] = value
    return "\n".join([_format_lines(plain)] * bool(plain) + [f"{head}\n{_format_lines(one)}" for head, one in tables])


def _format_lines(values: Mapping[str, Any]) -> str:
    return "".join(f"{_quote_key(key)} = {_quote(value)}\n" for key, value in values.items() if value is not None)


def _quote_key(key: str) -> str:
    bare = key.replace("_", "").replace("-", "").isalnum() and key.isascii()
    return key if bare else _quote(key)


def _quote(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_quote_key(k)} = {_quote(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_quote(item) for item in value) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # inf, -inf or nan, which JSON writes in another way
    if isinstance(value, str) and not is_unicode(value):
        value = show_name(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
