"""Shared libraries that pip cannot install, and the Debian packages that bring them."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from tactile_loc_cli.doctor.check import Check, State
from tactile_loc_cli.doctor.outside import attempt

# scripts/system-packages.sh of the source tree knows the same pairs; a test compares them
PACKAGES: Mapping[str, str] = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libgomp.so.1": "libgomp1",
}
USERS: Mapping[str, str] = {"libEGL.so.1": "the renderer pyrender"}  # all others: open3d
DRIVER = "libgl1-mesa-dri"  # Mesa's drivers, which need no GPU
DRIVER_PATTERNS = ("lib/dri/*_dri.so", "lib64/dri/*_dri.so", "lib/*/dri/*_dri.so", "lib/*/libgallium-*.so")


def shared_libraries() -> Iterator[Check]:
    """Say which shared libraries are missing; on other systems than Linux nothing is looked at."""
    if sys.platform != "linux":
        return
    outcome = attempt("shared-libraries", *PACKAGES)
    if outcome.failure:
        yield Check("system libraries", State.BROKEN, outcome.failure)
        return
    for library in outcome.facts["missing"]:
        user = USERS.get(library, "open3d")
        yield Check(library, State.MISSING, f"{user} needs it", install(PACKAGES[library]))
    if not has_egl_driver():
        remedy = install(DRIVER)
        yield Check("EGL driver", State.MISSING, "the renderer pyrender needs one, Mesa's or NVIDIA's", remedy)
    if not outcome.facts["missing"]:
        yield Check("system libraries", State.OK, "all there")


def has_egl_driver() -> bool:
    """Whether there is a driver behind libEGL, which only dispatches."""
    if not attempt("shared-libraries", "libEGL_nvidia.so.0").facts.get("missing", True):
        return True
    return any(found for pattern in DRIVER_PATTERNS for found in Path("/usr").glob(pattern))


def install(package: str) -> str:
    """Return how to install a Debian package, here."""
    if shutil.which("apt-get"):
        return f"sudo apt-get install {package}"
    return f"install what Debian calls {package} with this system's package manager"


def remedy_for(failure: str, otherwise: str) -> str:
    """Return how to install the shared library that a failure names; `otherwise` when it names none."""
    return next((install(package) for library, package in PACKAGES.items() if library in failure), otherwise)
