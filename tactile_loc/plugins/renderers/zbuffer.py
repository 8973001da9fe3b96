"""Exact rendering by a z-buffer, triangle by triangle, without another library."""

from tactile_loc.plugin import Float32, Poses, Renderer, SensorGeometry, TriangleMesh
from tactile_loc.plugin.helpers import draw_nearest_depths


class ZBufferRenderer(Renderer):
    """Draws every triangle into every picture: as exact as ray casting, and faster for small meshes."""

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths (N, H, W), metres, of poses (N, 4, 4) in contact. Depths beyond the band are inf."""
        return draw_nearest_depths(mesh, T_sensor_object, geometry)
