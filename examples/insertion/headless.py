"""Chooses how MuJoCo draws without a display. Call `choose_backend` before the first import of mujoco."""

import ctypes
import os
import subprocess
import sys

_TRIAL = "import ctypes; ctypes.CDLL('libEGL.so.1')"


def choose_backend(drawing: bool) -> None:
    """Set MUJOCO_GL, unless the user has set it: EGL, or OSMesa with a message if there is no EGL.

    Without `drawing`, MuJoCo loads no OpenGL at all.
    """
    if not drawing:
        os.environ.setdefault("MUJOCO_GL", "disable")
    elif "MUJOCO_GL" not in os.environ:
        found = subprocess.run([sys.executable, "-c", _TRIAL], capture_output=True, check=False).returncode == 0
        os.environ["MUJOCO_GL"] = "egl" if found else "osmesa"
        if not found:
            print("EGL was not found, so MuJoCo draws with OSMesa, slowly; install libegl1 for EGL", file=sys.stderr)
    backend = os.environ["MUJOCO_GL"]
    if backend in ("egl", "osmesa"):
        os.environ["PYOPENGL_PLATFORM"] = backend  # otherwise, the display's platform is loaded
    if backend == "egl":
        add_missing_type()


def add_missing_type() -> None:
    """Add a type that MuJoCo needs, and PyOpenGL 3.1.0 lacks. pyrender pins this release."""
    from OpenGL import EGL

    if not hasattr(EGL, "EGLDeviceEXT"):
        EGL.EGLDeviceEXT = ctypes.c_void_p
