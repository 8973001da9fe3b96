"""Content hashes: one string for all inputs of a stage. The string changes exactly when an input changes."""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import StoreError

JsonValue = str | int | float | bool | None | list[Any] | tuple[Any, ...] | Mapping[str, Any]

MEANINGS = {  # what a stage makes, for messages
    "surface": "the mesh in metres",
    "symmetry": "the object's symmetry",
    "grid": "poses in contact",
    "shapes": "contact shapes of the grid",
    "places": "places of the object that can touch first",
    "encoder": "training of the encoder",
    "bank": "encoded contact shapes",
    "temperature": "fit of the probabilities",
    "evaluation": "evaluated touches",
    "contact-evaluation": "evaluated sets of touches",
    "recall-evaluation": "evaluated examples",
    "calibration": "training of a calibration",
}

SHORT_DIGITS = 16  # of a hash that names a file or a job

_STAGE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


@dataclass(frozen=True)
class StageKey:
    """The origin of an artifact: the stage, the version of the stage's code, and all inputs of the stage.

    Two keys are equal when their digests are equal. The inputs are copied, so later changes of the mapping do not
    affect the key. Replace large inputs by their hash (`hash_arrays`, `hash_file`, another key's digest). Raises
    StoreError if the stage is not a plain name or an input is not a finite JSON value.
    """

    stage: str = field(compare=False)
    version: int = field(compare=False)
    inputs: Mapping[str, JsonValue] = field(compare=False)
    label: str = field(default="", compare=False)
    """A name for people, such as the name of the object. It is not part of the key."""
    digest: str = field(init=False)
    """The SHA-256, 64 hexadecimal digits, of the canonical JSON of stage, version and inputs."""

    def __post_init__(self) -> None:
        if not _STAGE_NAME.fullmatch(self.stage):
            raise StoreError(f"{self.stage!r} cannot name a stage; use letters, digits, '-' and '_'")
        inputs = _copy_plain(self.inputs, f"stage {self.stage!r}: the input")
        object.__setattr__(self, "inputs", inputs)
        values = {"stage": self.stage, "version": self.version, "inputs": inputs}
        object.__setattr__(self, "digest", hash_json(values))

    @property
    def short(self) -> str:
        """The first 16 digits of the digest: the name of the artifact's folder."""
        return self.digest[:SHORT_DIGITS]

    def __str__(self) -> str:
        return f"{self.stage} {self.short}"

    def explain(self) -> str:
        """Return the key as text with the meaning of the stage: "temperature 0123456789abcdef (fit of ...)"."""
        return f"{self} ({MEANINGS[self.stage]})" if self.stage in MEANINGS else str(self)


def write_canonical_json(value: JsonValue) -> str:
    """Return the canonical JSON text of a value: keys sorted, no spaces, ASCII only, floats by `repr`, tuples as lists.

    Raises StoreError for NaN, an infinity, a key that is not a string, or a value that JSON cannot represent.
    """
    return json.dumps(_copy_plain(value, "the value"), sort_keys=True, separators=(",", ":"))


def hash_json(value: JsonValue) -> str:
    """Return the SHA-256 (64 hexadecimal digits) of the canonical JSON of a value. Raises StoreError."""
    return hashlib.sha256(write_canonical_json(value).encode()).hexdigest()


def hash_shortly(value: JsonValue) -> str:
    """Return the first SHORT_DIGITS digits of `hash_json`."""
    return hash_json(value)[:SHORT_DIGITS]


def hash_arrays(**arrays: NDArray[Any]) -> str:
    """Return the SHA-256 (hex) of named arrays of any shape: names, dtypes, shapes and values in C order.

    The order of the names and the memory layout do not matter. Raises StoreError if an array holds Python objects.
    """
    digest = hashlib.sha256()
    for name, values in sorted(arrays.items()):
        array = np.asarray(values)
        if array.dtype.hasobject:
            raise StoreError(f"the array {name!r} holds Python objects and cannot be hashed; convert it to numbers")
        header = json.dumps([name, str(np.lib.format.dtype_to_descr(array.dtype)), array.shape])
        digest.update(f"{header}\n".encode())
        digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def hash_file(path: Path) -> str:
    """Return the SHA-256 (hex) of a file's content. Raises StoreError if the file cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError) as error:  # ValueError: no file can have this name
        reason = getattr(error, "strerror", None) or error
        raise StoreError(f"{path} cannot be read ({reason}); check the path and its permissions") from error


def _copy_plain(value: object, where: str) -> Any:
    """Return a deep copy of a JSON value. Raises StoreError, which names the place, for a value of another type."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    if isinstance(value, list | tuple):
        return [_copy_plain(item, f"{where}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        return {str(name): _copy_plain(item, f"{where}[{name!r}]") for name, item in value.items()}
    found = str(value) if isinstance(value, float) else f"of type {type(value).__module__}.{type(value).__qualname__}"
    if isinstance(value, Mapping):
        found = "a mapping whose keys are not all strings"
    raise StoreError(f"{where} is {found}; use finite JSON values, and hash_arrays for arrays")
