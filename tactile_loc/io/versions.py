"""The versions of tactile-loc, python and the installed libraries: a part of every result."""

from __future__ import annotations

import platform
from importlib import metadata

LIBRARIES = (
    "faiss-cpu", "numba", "numpy", "open3d", "open3d-cpu", "pluggy", "pydantic", "pyrender", "scipy", "torch", "trimesh"
)  # fmt: skip


def read_versions() -> dict[str, str]:
    """Return the versions of tactile-loc, python and those of its libraries that are installed."""
    found = {"tactile-loc": metadata.version("tactile-loc"), "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
