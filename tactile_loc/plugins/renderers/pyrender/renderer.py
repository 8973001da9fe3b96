"""Rendering with OpenGL without a display: pyrender through EGL, on a graphics card or Mesa's software driver."""

from __future__ import annotations

import os
from importlib.util import find_spec
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from tactile_loc.plugin import ComponentOptions, Float32, Poses, Renderer, RenderError, SensorGeometry, TriangleMesh

if find_spec("pyrender") is None:  # it is imported with the first OpenGL context
    raise ModuleNotFoundError("No module named 'pyrender'", name="pyrender")

if TYPE_CHECKING:
    from tactile_loc.plugins.renderers.pyrender.gl import DepthScene, Offscreen


class PyrenderRenderer(Renderer):
    """Draws every pose with OpenGL. Depths may differ by nanometres between graphics drivers.

    The OpenGL context is made for the first picture and lives until `close` or the end of the renderer. Only one thread
    at a time can draw with a context, so other threads wait.
    """

    _offscreen: Offscreen | None = None
    _scene: DepthScene | None = None

    def __init__(self, options: ComponentOptions | None = None) -> None:
        super().__init__(options)
        self._drawing = Lock()

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths z (N, H, W) in metres at pixel centres for poses (N, 4, 4).

        Pixels without a surface are inf, and so are surfaces deeper than standoff + max_depth. For a pinhole sensor,
        surfaces nearer to the camera than a tenth of the standoff are inf, too. Raises RenderError when no OpenGL
        context can be made.
        """
        depth = np.empty((len(T_sensor_object), *geometry.shape), np.float32)
        with self._drawing:
            offscreen, scene = self._prepare_context(geometry), self._prepare_scene(mesh, geometry)
            with offscreen.current():
                for picture, T in zip(depth, T_sensor_object, strict=True):
                    picture[:] = scene.draw(offscreen, T)
        return depth

    def _prepare_context(self, geometry: SensorGeometry) -> Offscreen:
        """Return the OpenGL context, set to the geometry's picture size. The context is made at first use."""
        if self._offscreen is None:
            self._offscreen = _open(geometry)
        self._offscreen.viewport_height, self._offscreen.viewport_width = geometry.shape
        return self._offscreen

    def _prepare_scene(self, mesh: TriangleMesh, geometry: SensorGeometry) -> DepthScene:
        """Return a scene of the mesh and the camera. The last scene is reused if both are the same objects."""
        from tactile_loc.plugins.renderers.pyrender.gl import DepthScene

        if self._scene is None or self._scene.mesh is not mesh or self._scene.geometry is not geometry:
            self._scene = DepthScene(mesh, geometry)
        return self._scene

    def close(self) -> None:
        """Free the OpenGL context. The next picture makes a new one."""
        offscreen, self._offscreen, self._scene = self._offscreen, None, None
        if offscreen is not None:
            offscreen.delete()


def _open(geometry: SensorGeometry) -> Offscreen:
    """Make an OpenGL context. Raises RenderError, with the packages to install, when this fails."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")  # PyOpenGL reads it on import
    try:
        from tactile_loc.plugins.renderers.pyrender.gl import Offscreen

        return Offscreen(geometry.width_px, geometry.height_px)
    except Exception as error:  # a missing library, driver or device raises many kinds of errors
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:120]
        raise RenderError(
            f"the pyrender renderer cannot make an OpenGL context ({reason}); on Debian, install libegl1 and "
            "libgl1-mesa-dri, or choose `renderer` heightmap or `renderer` raycast"
        ) from error
