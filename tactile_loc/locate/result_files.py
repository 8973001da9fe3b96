"""Writing and reading `result.npz`, the arrays beside `result.json`."""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import TactileLocError
from tactile_loc.locate.result_arrays import ResultArrays, as_arrays, from_arrays
from tactile_loc.locate.result_json import ResultRecord
from tactile_loc.reports.source import ResultError
from tactile_loc.store.files import write_atomically

SCHEMA_VERSION = 1
NAME = "result.npz"
AGAIN = "run tactile-loc again, which writes both files"


def write_arrays(path: Path, arrays: ResultArrays, record: ResultRecord) -> Path:
    """Write the arrays of a record's result as .npz, atomically, and return the path. Raises OutputError."""
    head = {"schema_version": np.array(SCHEMA_VERSION), "result_sha256": np.array(fingerprint(record))}
    stored: dict[str, Any] = {**head, **as_arrays(arrays)}
    return write_atomically(path, lambda temporary: np.savez_compressed(temporary, allow_pickle=False, **stored))


def read_arrays(path: Path, record: ResultRecord) -> ResultArrays:
    """Read the arrays that belong to a record. Raises ResultError, in one sentence, when they cannot be used."""
    if not path.is_file():
        raise ResultError(f"there is no {path}, which a report of this result needs; {AGAIN}")
    stored = _stored(path)
    version = stored.pop("schema_version", None)
    if version is None or str(version) != str(SCHEMA_VERSION):
        raise ResultError(
            f"{path} is of version {version}, and this tactile-loc reads version {SCHEMA_VERSION}; {AGAIN}"
        )
    if str(stored.pop("result_sha256", "")) != fingerprint(record):
        raise ResultError(f"{path} belongs to another result than the .json file beside it; {AGAIN}")
    try:
        arrays = from_arrays(stored)
    except (KeyError, ValueError, TypeError, TactileLocError) as error:
        raise ResultError(f"{path} is damaged or incomplete ({error}); {AGAIN}") from error
    if any(len(touch.made_m) != len(record.hypotheses) for touch in arrays.touches):
        raise ResultError(f"{path} is incomplete: it does not hold a contact shape of every hypothesis; {AGAIN}")
    return arrays


def fingerprint(record: ResultRecord) -> str:
    """Return the SHA-256 (hex) of a record's content: what ties the two files together."""
    return hashlib.sha256(record.model_dump_json().encode()).hexdigest()


def _stored(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, AttributeError) as error:
        raise ResultError(f"{path} is damaged: it cannot be read as .npz; {AGAIN}") from error
