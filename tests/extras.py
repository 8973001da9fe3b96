"""Tests in an environment without an extra: a test that needs its library, or an annex, is skipped with a reason."""

import re
from importlib.util import find_spec

from tactile_loc.core.runtime.errors import MissingLibraryError

# What the extras, `dev` and the annexes install, by the names of its modules. Other libraries are never excused.
OPTIONAL = {
    "ContactMechanics", "OpenGL", "apsw", "cascadio", "collada", "cv2", "distributed", "faiss", "fcl", "griffe",
    "gtsam", "kiss_icp", "lxml", "lz4", "manifold3d", "markdown", "mcap", "mujoco", "nbformat", "networkx",
    "open3d", "pyarrow", "pyrender", "rerun", "rosbags", "rtree", "ruff", "selenium", "small_gicp",
    "tactile_loc_app", "tactile_loc_benchmark", "tactile_loc_inspect", "tactile_loc_library",
    "tactile_loc_test_object", "tactile_loc_touchability", "torch", "viser", "yaml", "zstandard",
}  # fmt: skip
NOT_INSTALLED = re.compile(r"needs ([\w-]+), which is not installed|No module named '([\w.]+)'")


def find_missing_library(said: str) -> str | None:
    """Return the library or the annex that a message names, if it is really not installed, or None."""
    for one, other in NOT_INSTALLED.findall(said):
        name = (one or other).partition(".")[0].replace("-", "_")
        if name in OPTIONAL and find_spec(name) is None:
            return name
    return None


def find_missing_cause(error: BaseException | None) -> str | None:
    """Return the library whose absence caused an error, or None."""
    while error is not None:
        if isinstance(error, ImportError | MissingLibraryError) and (missing := find_missing_library(str(error))):
            return missing
        error = error.__cause__ or error.__context__
    return None
