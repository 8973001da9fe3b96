"""Trials of libraries that may crash or hang, each in its own process: `python -m tactile_loc_cli.doctor.trials NAME`.

A trial prints its facts as one line of JSON, with a text for users under "says". A trial that fails writes the reason
as the last line of stderr.
"""

import importlib
import json
import shutil
import sys
from collections.abc import Callable, Mapping
from typing import Any

from tactile_loc.core.runtime.errors import TactileLocError

Facts = dict[str, Any]


def import_library(module: str) -> Facts:
    """Import a library."""
    importlib.import_module(module)
    return {}


def try_egl() -> Facts:
    """Render a small square, 1 mm beyond the undeformed gel, without a display."""
    import numpy as np

    from tactile_loc.core.objects.mesh import TriangleMesh
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
    from tactile_loc.plugins.renderers.pyrender.renderer import PyrenderRenderer

    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float) * 0.01
    mesh = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    geometry = SensorGeometry("orthographic", 16, 12, 1000.0, 1000.0, 8.0, 6.0, 0.010, 0.002)
    T_sensor_object = np.eye(4)
    T_sensor_object[2, 3] = 0.011
    depth_m = PyrenderRenderer().render(mesh, T_sensor_object[None], geometry)[0, 6, 8]
    if abs(depth_m - 0.011) > 1e-5:
        raise ValueError(f"it renders a surface at {1e3 * depth_m:.2f} mm instead of 11 mm")
    return {"says": "renders without a display"}


def try_open3d() -> Facts:
    """Cast one ray at a triangle one metre away."""
    import numpy as np
    import open3d as o3d

    scene, tensor = o3d.t.geometry.RaycastingScene(), o3d.core.Tensor.from_numpy
    corners = np.array([[-1, -1, 1], [1, -1, 1], [0, 1, 1]], np.float32)
    scene.add_triangles(tensor(corners), tensor(np.array([[0, 1, 2]], np.uint32)))
    ray = tensor(np.array([[0, 0, 0, 0, 0, 1]], np.float32))
    distance_m = float(scene.cast_rays(ray)["t_hit"].numpy()[0])
    if abs(distance_m - 1) > 1e-5:
        raise ValueError(f"its ray hits a triangle at {distance_m:g} m instead of 1 m")
    return {"says": "casts rays"}


def try_numba() -> Facts:
    """Compile a function and run it."""
    from numba import njit

    @njit
    def triangular(n: int) -> int:
        total = 0
        for i in range(n + 1):
            total += i
        return total

    if triangular(10) != 55:
        raise ValueError("its compiled code gives wrong results")
    return {"says": "compiles"}


def try_torch() -> Facts:
    """Import torch and name its usable GPUs."""
    import torch

    devices = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    if devices:
        float(torch.ones(8, device="cuda").sum())
        says = f"computes on {', '.join(devices)}"
    elif shutil.which("nvidia-smi"):
        says = "computes on the CPU; there is an NVIDIA driver, but torch finds no CUDA GPU"
    else:
        says = "computes on the CPU; there is no CUDA GPU"
    return {"says": says, "cuda_devices": devices}


def load_shared_libraries(*names: str) -> Facts:
    """Load shared libraries by name, and return the names that cannot be loaded."""
    import ctypes

    missing = []
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            missing.append(name)
    return {"missing": missing}


def compile_kernels() -> Facts:
    """Prepare a small object, and draw a result, so that the code is compiled and kept on disk."""
    import tempfile
    import time

    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.view.one_versus_several import draw_one_versus_several

    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        chosen: dict[str, Any] = {"store": folder, "sensor": "gelsight-mini", "temperature": 0.01}
        localizer = Localizer.create("damping_pin", prepared=True, **chosen)
        touches = localizer.simulate_together(2)
        draw_one_versus_several(localizer.localize(touches[:1]), localizer.localize(touches), "")
    seconds = time.perf_counter() - start
    return {"says": f"compiled and tried in {seconds:.0f} s; later runs reuse it", "seconds": seconds}


TRIALS: Mapping[str, Callable[..., Facts]] = {
    "import": import_library,
    "egl": try_egl,
    "open3d": try_open3d,
    "numba": try_numba,
    "torch": try_torch,
    "shared-libraries": load_shared_libraries,
    "kernels": compile_kernels,
}


def main() -> None:
    """Run the trial named on the command line. The output of libraries goes to stderr."""
    stdout, sys.stdout = sys.stdout, sys.stderr
    try:
        facts = TRIALS[sys.argv[1]](*sys.argv[2:])
    except TactileLocError as error:
        sys.exit(str(error).partition(";")[0])  # without the advice: doctor gives its own
    stdout.write(json.dumps(facts) + "\n")


if __name__ == "__main__":
    main()
