"""Shared parts of the JSON documents of results: reading, hashes, and versions of libraries."""

import hashlib
import json
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic_core import PydanticSerializationError, to_json

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.store.files import read_json

LIBRARIES = (
    "faiss-cpu",
    "numba",
    "numpy",
    "open3d",
    "open3d-cpu",
    "pluggy",
    "pydantic",
    "pyrender",
    "scipy",
    "torch",
    "trimesh",
)


def hash_document(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 (hex) of a JSON document, which does not depend on spaces and line breaks."""
    try:
        text = to_json(document)
    except PydanticSerializationError:  # which refuses lone surrogates
        text = json.dumps(document).encode()
    return hashlib.sha256(text).hexdigest()


def read_document(path: Path) -> dict[str, Any]:
    """Return the JSON object in a result's file. Raises ResultError when the file cannot be read or holds no object."""
    try:
        found = read_json(path)
    except FileNotFoundError as error:
        raise ResultError(f"there is no file {path}; check the path") from error
    except OSError as error:
        raise ResultError(f"{path} cannot be read ({error.strerror or error}); check the path") from error
    except ValueError as error:
        raise ResultError(f"{path} is damaged: it is not JSON ({error}); make the result again") from error
    if not isinstance(found, dict):
        raise ResultError(f"{path} is not a result, but a {type(found).__name__}; give the .json file of a result")
    return found


def read_versions() -> dict[str, str]:
    """Return the versions of tactile-loc, python and the installed libraries."""
    found = {"tactile-loc": metadata.version("tactile-loc"), "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
