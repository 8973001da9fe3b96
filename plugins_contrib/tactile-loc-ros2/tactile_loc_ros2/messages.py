"""ROS messages made from poses and results. This module does not import ROS: it is given the message types."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import LocatedFrame, ObjectModel, RosPose, Verdict, simplify_mesh
from tactile_loc.plugin.helpers import make_transform

from tactile_loc_ros2.frames import NS

Floats = NDArray[np.float64]
FindType = Callable[[str], Callable[..., Any]]

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TEXT, FLAG, NUMBER = "std_msgs/msg/String", "std_msgs/msg/Bool", "std_msgs/msg/Float64"
MARKER, MARKERS = "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray"
DETECTIONS, POINTS = "vision_msgs/msg/Detection3DArray", "sensor_msgs/msg/PointCloud2"
CAMERA = "sensor_msgs/msg/CameraInfo"
FLOAT32 = 7  # of sensor_msgs/PointField

SPHERE, MESH_RESOURCE, TRIANGLE_LIST = 2, 10, 11  # of visualization_msgs/Marker
ADD, DELETE_ALL = 0, 3
MOST_TRIANGLES = 1000  # of a mesh that is sent as triangles with each marker
MOST_ALTERNATIVES = 5
DEVIATIONS = 2.0  # standard deviations of the ellipsoid's half axes
LEAST_AXIS_M = 1e-5  # RViz does not display markers without extent
OPAQUE, TRANSPARENT = 0.9, 0.2
COLOURS = {
    Verdict.CERTAIN: (0.1, 0.7, 0.2),
    Verdict.AMBIGUOUS: (1.0, 0.65, 0.0),
    Verdict.POOR_FIT: (0.85, 0.1, 0.1),
    Verdict.NOT_FOUND: (0.5, 0.5, 0.5),
    Verdict.NO_CONTACT: (0.4, 0.6, 0.9),
}
BLUE = (0.2, 0.4, 1.0)


class MessageMaker:
    """Makes ROS messages. `find_type` returns the class of a type such as `std_msgs/msg/String`.

    The classes must give fields that are not stated their default values, as those of rclpy do.
    """

    def __init__(self, find_type: FindType) -> None:
        self.find_type = find_type

    def make_header(self, stamp_ns: int, frame: str) -> Any:
        """Return the std_msgs Header of a time, ns, and a frame."""
        stamp = self.find_type("builtin_interfaces/msg/Time")(sec=int(stamp_ns // NS), nanosec=int(stamp_ns % NS))
        return self.find_type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)

    def make_text(self, text: str) -> Any:
        """Return the std_msgs String of a text."""
        return self.find_type(TEXT)(data=text)

    def make_flag(self, value: bool) -> Any:
        """Return the std_msgs Bool of a value."""
        return self.find_type(FLAG)(data=bool(value))

    def make_number(self, value: float) -> Any:
        """Return the std_msgs Float64 of a number."""
        return self.find_type(NUMBER)(data=float(value))

    def make_pose(self, T: Floats, stamp_ns: int, frame: str) -> Any:
        """Return the geometry_msgs PoseStamped of a pose (4, 4), metres, in `frame`."""
        return self.find_type(POSE)(header=self.make_header(stamp_ns, frame), pose=self._make_pose(RosPose.of(T, None)))

    def make_pose_with_covariance(self, T: Floats, covariance: Floats | None, stamp_ns: int, frame: str) -> Any:
        """Return the geometry_msgs PoseWithCovarianceStamped of a pose (4, 4), metres, in `frame`.

        The covariance (6, 6) is as in RefinedPose. If it is None, the message's first number is -1.
        """
        header, pose = self.make_header(stamp_ns, frame), self._make_uncertain_pose(T, covariance)
        return self.find_type(POSE_WITH_COVARIANCE)(header=header, pose=pose)

    def make_detections(self, located: LocatedFrame, obj: ObjectModel, stamp_ns: int, frame: str) -> Any:
        """Return the vision_msgs Detection3DArray of a result in `frame`: one detection, or none without a pose.

        Each pose is a hypothesis with its probability as score, and its covariance as in a PoseWithCovariance. The box
        encloses the object at the most probable pose.
        """
        header, listed = self.make_header(stamp_ns, frame), list[Any]()
        if (T := located.T_sensor_object) is not None:
            low, high = obj.mesh.vertices_m.min(axis=0), obj.mesh.vertices_m.max(axis=0)
            middle = T @ make_transform(np.eye(3), (low + high) / 2)
            box = self.find_type("vision_msgs/msg/BoundingBox3D")(
                center=self._make_pose(RosPose.of(middle, None)), size=self._make_vector("Vector3", high - low)
            )
            results = self._make_hypotheses(located, obj.name)
            listed.append(self.find_type("vision_msgs/msg/Detection3D")(header=header, results=results, bbox=box))
        return self.find_type(DETECTIONS)(header=header, detections=listed)

    def make_points(self, points_m: Floats, stamp_ns: int, frame: str) -> Any:
        """Return the sensor_msgs PointCloud2 of points (N, 3), metres, in `frame`, with the fields x, y, z."""
        rows = np.ascontiguousarray(points_m, "<f4").reshape(-1, 3)
        fields = [
            self.find_type("sensor_msgs/msg/PointField")(name=name, offset=4 * k, datatype=FLOAT32, count=1)
            for k, name in enumerate("xyz")
        ]
        layout = {"height": 1, "width": len(rows), "point_step": 12, "row_step": 12 * len(rows)}
        data, header = array("B", rows.tobytes()), self.make_header(stamp_ns, frame)
        return self.find_type(POINTS)(
            header=header, fields=fields, data=data, is_bigendian=False, is_dense=True, **layout
        )

    def make_transforms(self, T_parent_child: Mapping[tuple[str, str], Floats], stamp_ns: int) -> Any:
        """Return the tf2_msgs TFMessage of transforms (4, 4), metres, with keys (parent, child)."""
        listed = []
        for (parent, child), T in T_parent_child.items():
            pose = RosPose.of(T, None)
            moved = self.find_type("geometry_msgs/msg/Transform")(
                translation=self._make_vector("Vector3", pose.position_m),
                rotation=self._make_vector("Quaternion", pose.quaternion_xyzw),
            )
            listed.append(
                self.find_type("geometry_msgs/msg/TransformStamped")(
                    header=self.make_header(stamp_ns, parent), child_frame_id=child, transform=moved
                )
            )
        return self.find_type(TRANSFORMS)(transforms=listed)

    def make_point(self, xyz_m: Sequence[float]) -> Any:
        """Return the geometry_msgs Point of three coordinates, metres."""
        return self._make_vector("Point", xyz_m)

    def make_marker(
        self,
        header: Any,
        name: str,
        kind: int,
        number: int,
        T: Floats,
        scale_m: Sequence[float],
        colour: Sequence[float],
        **more: Any,
    ) -> Any:
        """Return a visualization_msgs Marker at a pose (4, 4), metres.

        `kind` is the marker's type, `scale_m` are three factors or lengths, and `colour` is red, green, blue, alpha.
        """
        pose, scale = self._make_pose(RosPose.of(T, None)), self._make_vector("Vector3", scale_m)
        named = {"header": header, "ns": name, "id": number, "type": kind, "action": ADD}
        return self.find_type(MARKER)(**named, pose=pose, scale=scale, color=self._make_colour(colour), **more)

    def make_deletion(self, header: Any) -> Any:
        """Return the visualization_msgs Marker that deletes all markers of its topic."""
        return self.find_type(MARKER)(header=header, action=DELETE_ALL)

    def make_markers(self, markers: Sequence[Any]) -> Any:
        """Return a visualization_msgs MarkerArray."""
        return self.find_type(MARKERS)(markers=list(markers))

    def _make_hypotheses(self, located: LocatedFrame, name: str) -> list[Any]:
        known = dict(enumerate(located.covariances)) or {0: located.covariance}
        listed = []
        for k, (T, p) in enumerate(zip(located.T_sensor_object_modes, located.probabilities, strict=True)):
            C = known.get(k)
            hypothesis = self.find_type("vision_msgs/msg/ObjectHypothesis")(class_id=name, score=float(p))
            pose = self._make_uncertain_pose(T, None if C is None or np.isnan(C).any() else C)
            kind = self.find_type("vision_msgs/msg/ObjectHypothesisWithPose")
            listed.append(kind(hypothesis=hypothesis, pose=pose))
        return listed

    def _make_uncertain_pose(self, T: Floats, covariance: Floats | None) -> Any:
        pose = RosPose.of(T, covariance)
        kind = self.find_type("geometry_msgs/msg/PoseWithCovariance")
        return kind(pose=self._make_pose(pose), covariance=np.array(pose.covariance))

    def _make_pose(self, pose: RosPose) -> Any:
        return self.find_type("geometry_msgs/msg/Pose")(
            position=self.make_point(pose.position_m), orientation=self._make_vector("Quaternion", pose.quaternion_xyzw)
        )

    def _make_vector(self, kind: str, values: Sequence[float]) -> Any:
        return self.find_type(f"geometry_msgs/msg/{kind}")(**dict(zip("xyzw", map(float, values), strict=False)))

    def _make_colour(self, rgba: Sequence[float]) -> Any:
        return self.find_type("std_msgs/msg/ColorRGBA")(**dict(zip("rgba", map(float, rgba), strict=True)))


class MarkerMaker:
    """Makes the markers of results: the object, its alternative poses, and the uncertainty of its position.

    RViz loads the mesh from `mesh_resource`, in units of `mesh_scale` metres. Without it, the markers hold the object's
    surface, decimated to about MOST_TRIANGLES.
    """

    def __init__(self, maker: MessageMaker, obj: ObjectModel, mesh_resource: str = "", mesh_scale: float = 1.0) -> None:
        self._maker, self._resource, self._scale = maker, mesh_resource, mesh_scale
        self._points: list[Any] = []
        if not mesh_resource:
            mesh = obj.mesh if len(obj.mesh.faces) <= MOST_TRIANGLES else simplify_mesh(obj.mesh, MOST_TRIANGLES)
            self._points = [maker.make_point(xyz) for xyz in mesh.vertices_m[mesh.faces.ravel()]]

    def make(self, located: LocatedFrame, stamp_ns: int, frame: str) -> Any:
        """Return the MarkerArray of a result in `frame`. It replaces all earlier markers.

        The colour is that of the verdict. Alternative poses are the more transparent, the less probable they are.
        """
        header = self._maker.make_header(stamp_ns, frame)
        markers = [self._maker.make_deletion(header)]
        T, p = located.T_sensor_object_modes, located.probabilities
        colour = COLOURS.get(located.verdict, COLOURS[Verdict.NOT_FOUND]) if located.verdict else (0.5, 0.5, 0.5)
        if len(T):
            markers.append(self._make_object(header, "object", 0, T[0], (*colour, OPAQUE)))
        for k in range(1, min(len(T), 1 + MOST_ALTERNATIVES)):
            alpha = TRANSPARENT * max(0.25, float(p[k] / max(p[0], 1e-9)))
            markers.append(self._make_object(header, "alternatives", k, T[k], (*colour, min(alpha, TRANSPARENT))))
        if len(T) and located.covariance is not None:
            markers.append(self._make_ellipsoid(header, T[0], located.covariance))
        return self._maker.make_markers(markers)

    def _make_object(self, header: Any, name: str, number: int, T: Floats, colour: Sequence[float]) -> Any:
        if self._resource:
            scale = [self._scale] * 3
            return self._maker.make_marker(
                header, name, MESH_RESOURCE, number, T, scale, colour, mesh_resource=self._resource
            )
        return self._maker.make_marker(header, name, TRIANGLE_LIST, number, T, [1.0] * 3, colour, points=self._points)

    def _make_ellipsoid(self, header: Any, T: Floats, covariance: Floats) -> Any:
        """Return the ellipsoid of the position's uncertainty; its half axes are DEVIATIONS standard deviations."""
        variances, axes = np.linalg.eigh(covariance[:3, :3])
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        lengths_m = np.maximum(2 * DEVIATIONS * np.sqrt(np.maximum(variances, 0.0)), LEAST_AXIS_M)
        return self._maker.make_marker(
            header, "uncertainty", SPHERE, 0, make_transform(axes, T[:3, 3]), lengths_m, (*BLUE, 0.4)
        )
