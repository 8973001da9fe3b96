"""The renderer slot: depth images of an object, as seen by the camera behind the gel."""

from abc import abstractmethod

from tactile_loc.core.geometry.rigid import Float32, Poses
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.slots.component import Component


class Renderer(Component):
    """Renders the object as the sensor's camera would see it."""

    slot = "renderer"

    @abstractmethod
    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depth z (N, H, W) in metres at pixel centres for poses (N, 4, 4).

        Depths are exact between standoff and standoff + max_depth; depths beyond may be inf. The poses are already in
        contact.
        """

    def render_apart(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return depths (N, H, W), metres, like `render`, for poses with different rotations, such as random poses.

        Override this method if such poses can be rendered faster or more exactly than the poses of a grid.
        """
        return self.render(mesh, T_sensor_object, geometry)
