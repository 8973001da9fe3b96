"""The OpenGL side of the pyrender renderer. Set PYOPENGL_PLATFORM before importing this module.

PyOpenGL reads this variable on import.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyrender
from numpy.typing import NDArray
from OpenGL.error import Error as OpenGLError
from pyrender.constants import RenderFlags
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactile_loc.plugin import RenderError, SensorGeometry, TriangleMesh

# pyrender disables multisampling for segmentation only. With multisampling, the depth is not taken at the pixel's
# centre. On a slope, it is then wrong by tens of micrometres.
_FLAGS = RenderFlags.DEPTH_ONLY | RenderFlags.SEG
_BLACK = (0, 0, 0)


class DepthCamera(pyrender.Camera):  # type: ignore[misc]
    """A camera with any principal point and focal lengths that projects points given in the sensor frame.

    pyrender linearises the depth buffer of every camera as if the camera were perspective, with the camera's znear and
    zfar. These are 1 and 2 here, and `depth_m` undoes the linearisation. The true clipping planes are `_near_m` and
    `_far_m`.
    """

    def __init__(self, geometry: SensorGeometry) -> None:
        super().__init__(znear=1.0, zfar=2.0)
        self._geometry = geometry
        # With a near plane at a tenth of the standoff, parts that stick out beside the sensor are not clipped. The 24
        # bits of the depth buffer still resolve tens of nanometres.
        self._near_m = 0.1 * geometry.standoff_m if geometry.is_pinhole else 0.0
        self._far_m = geometry.standoff_m + 1.01 * geometry.max_depth_m

    def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> NDArray[np.float64]:
        """Return the matrix (4, 4) from the sensor frame in metres to OpenGL's clip coordinates."""
        g, near, far = self._geometry, self._near_m, self._far_m
        P = np.zeros((4, 4))
        offset = 2 if g.is_pinhole else 3  # the column that is multiplied by z, or by one
        P[0, 0], P[0, offset] = 2.0 * g.fx / g.width_px, 2.0 * g.cx / g.width_px - 1.0
        P[1, 1], P[1, offset] = -2.0 * g.fy / g.height_px, 1.0 - 2.0 * g.cy / g.height_px
        P[2, 2], P[2, 3] = (near + far, -2.0 * near * far) if g.is_pinhole else (2.0, -near - far)
        P[2] /= far - near
        P[3, offset] = 1.0
        return P

    def depth_m(self, rendered: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return camera depths z (H, W) in metres, or inf, from pyrender's depths, which are 0 without a surface."""
        scale, shift = self.get_projection_matrix()[2, 2:]
        depth = np.full(rendered.shape, np.inf, np.float32)
        hit = rendered > 0.0
        ndc = 3.0 - 4.0 / rendered[hit].astype(float)
        depth[hit] = shift / (ndc - scale) if self._geometry.is_pinhole else (ndc - shift) / scale
        return depth


class DepthScene:
    """A scene with one mesh and one camera."""

    def __init__(self, mesh: TriangleMesh, geometry: SensorGeometry) -> None:
        self.mesh, self.geometry = mesh, geometry
        surface = pyrender.Primitive(mesh.vertices_m.astype(np.float32), indices=choose_faces(mesh))
        self._camera = DepthCamera(geometry)
        self._scene = pyrender.Scene()
        self._scene.add(self._camera)
        self._node = self._scene.add(pyrender.Mesh([surface]))

    def draw(self, offscreen: Offscreen, T_sensor_object: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return camera depths (H, W), metres, at one pose (4, 4). Pixels without a surface are inf."""
        self._scene.set_pose(self._node, T_sensor_object)
        return self._camera.depth_m(offscreen.render(self._scene, _FLAGS, {self._node: _BLACK}))


def choose_faces(mesh: TriangleMesh) -> NDArray[np.int64]:
    """Return the faces (F', 3) to draw. Faces that may be seen from behind are listed with both windings.

    This is needed because pyrender does not draw back faces. Only the faces of a connected part that is closed and
    wound outward are never seen from behind.
    """
    count = len(mesh.vertices_m)
    start, end = mesh.faces[:, [0, 1, 2]].T.ravel(), mesh.faces[:, [1, 2, 0]].T.ravel()
    _, part = connected_components(coo_array((np.ones(len(start)), (start, end)), (count, count)), directed=False)
    a, b, c = np.moveaxis(mesh.triangles_m - mesh.vertices_m[0], 1, 0)
    volume = np.bincount(part[mesh.faces[:, 0]], np.einsum("fk,fk->f", a, np.cross(b, c)), minlength=part.max() + 1)
    # In a closed, consistent part, both directions of each edge are equally frequent.
    _, edge = np.unique(np.minimum(start, end) * count + np.maximum(start, end), return_inverse=True)
    balance = np.bincount(edge, np.where(start < end, 1.0, -1.0))
    doubtful = volume <= 0.0
    doubtful[part[start[balance[edge] != 0.0]]] = True
    return np.concatenate([mesh.faces, mesh.faces[doubtful[part[mesh.faces[:, 0]]], ::-1]])


class Offscreen(pyrender.OffscreenRenderer):  # type: ignore[misc]
    """pyrender's offscreen renderer, made compatible with other OpenGL contexts and threads.

    The context of the original renderer stays current in the thread that drew last, so no other thread can use it. The
    original also calls eglTerminate at the end, which invalidates every other context of the process.
    """

    _platform: Any = None
    _renderer: Any = None

    @contextmanager
    def current(self) -> Iterator[None]:
        """Draw in the calling thread, and release the context afterwards. Raises RenderError when OpenGL fails."""
        try:
            yield
        except OpenGLError as error:
            raise RenderError(f"OpenGL cannot draw ({error!r:.200}); choose `renderer` heightmap") from error
        finally:
            self._release()

    def _release(self) -> None:
        if (display := getattr(self._platform, "_egl_display", None)) is not None:
            from OpenGL import EGL

            EGL.eglMakeCurrent(display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)

    def delete(self) -> None:
        """Free this renderer's OpenGL resources, unless they are already free.

        A renderer may be deleted while another renderer draws in the same thread, so the current context is restored.
        """
        platform, renderer, self._renderer = self._platform, self._renderer, None
        if platform is None or renderer is None:
            return
        self._platform = None
        if (display := getattr(platform, "_egl_display", None)) is None:
            platform.make_current()
            renderer.delete()
            platform.delete_context()
            return
        from OpenGL import EGL

        drawing = EGL.eglGetCurrentDisplay(), EGL.eglGetCurrentContext()
        surfaces = [EGL.eglGetCurrentSurface(which) for which in (EGL.EGL_DRAW, EGL.EGL_READ)]
        platform.make_current()
        renderer.delete()
        EGL.eglMakeCurrent(display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)
        if drawing[1] and drawing[1] != platform._egl_context:
            EGL.eglMakeCurrent(drawing[0], *surfaces, drawing[1])
        EGL.eglDestroyContext(display, platform._egl_context)
