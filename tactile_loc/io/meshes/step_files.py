"""Reads CAD files in the STEP format: OpenCASCADE, through cascadio, converts them to triangles in metres."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory

from tactile_loc.core.runtime.errors import MissingLibraryError, ObjectError
from tactile_loc.store.files import link_plainly

STEP_SUFFIXES = (".step", ".stp")
DEVIATION_MM, ANGLE_RAD = 0.005, 0.2  # largest distance and angle between the triangles and the exact surface

# In a process of its own, because OpenCASCADE writes to stdout, and a damaged file may crash it. cascadio would import
# trimesh to extend its reader, which takes longer than the conversion.
CONVERT = """\
import sys
sys.modules["trimesh"] = None
import cascadio
sys.exit(cascadio.step_to_glb(*sys.argv[1:3], *map(float, sys.argv[3:])))
"""


def is_step(path: Path) -> bool:
    """Return whether a path has a suffix of STEP files."""
    return path.suffix.lower() in STEP_SUFFIXES


def describe_step_reader() -> dict[str, str | float]:
    """Return all that decides which triangles a STEP file gives. Raises MissingLibraryError without cascadio."""
    try:
        version = metadata.version("cascadio")
    except metadata.PackageNotFoundError as error:
        raise MissingLibraryError(
            "STEP files are read with cascadio, which is not installed: pip install 'tactile-loc[step]'"
        ) from error
    return {"cascadio": version, "deviation_mm": DEVIATION_MM, "angle_rad": ANGLE_RAD}


@contextmanager
def convert_step(path: Path) -> Iterator[Path]:
    """Convert a STEP file to a temporary GLB file in metres, and yield its path. The file's unit is respected.

    Raises MissingLibraryError without cascadio, and ObjectError if the file is damaged.
    """
    describe_step_reader()
    with TemporaryDirectory(prefix="tactile-loc-step-") as folder, link_plainly(path) as plain:
        made = Path(folder) / "converted.glb"
        words = [str(plain.absolute()), str(made), str(DEVIATION_MM), str(ANGLE_RAD)]
        done = subprocess.run([sys.executable, "-P", "-c", CONVERT, *words], capture_output=True, check=False)
        if done.returncode != 0 or not made.is_file():
            raise ObjectError(f"{path} cannot be read as a STEP file; export it again as STEP, or as STL")
        yield made
