"""The 3D view of the page: the object at rest, the virtual finger, touches, hypotheses and the next touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import (
    DrawnScene,
    DrawnSensor,
    Localization,
    ObjectModel,
    RatedApproach,
    SensorGeometry,
    Touch,
    TriangleMesh,
    simplify_mesh,
)
from tactile_loc.plugin.helpers import (
    invert,
    make_transform,
    make_translation,
    quaternion_to_rotation,
    rotation_to_quaternion,
)

from tactile_loc_app.page.pictures import colour_probability
from tactile_loc_app.virtual_finger import Pose, Press

if TYPE_CHECKING:
    from viser import ClientHandle, TransformControlsHandle

UNITS_PER_M = 100.0  # one unit of the view is 1 cm, because cameras of the view do not come near small objects
MOST_FACES = 20_000  # triangles of the object in the view
STEEL, GEL, HOUSING, TOUCHED = (150, 158, 168), (92, 158, 230), (60, 66, 74), (224, 49, 49)
NEXT, EXPECTED = (43, 138, 62), (214, 170, 40)
LARGEST_M = 2e-3  # half axis of a drawn ellipsoid, at most; a small ellipsoid is magnified by a power of ten
SIGMAS = 2.0  # standard deviations of the half axes of ellipsoids in a DrawnScene
MOST_LIKELY = 500  # drawn poses of the posterior
PLAIN: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}  # shadows slow down a view without a GPU
LEAST_SHOWN = 0.01  # probability of a hypothesis that is drawn although it is not chosen
NEAR, FAR = 0.1, 500.0  # range that the camera of the view sees, in units of the view
FROM = np.array([0.75, -1.0, 0.7])  # direction from which the object is seen at first
PHONE_ASPECT, PHONE_AWAY, SHEET = 0.6, 1.5, 0.6  # on a narrow page, controls cover the lower part (a share) of the view
COVERING = 1.01  # scale of the chosen hypothesis, which hides the object at rest if both poses are equal


def to_view(T: Pose) -> dict[str, NDArray[np.float64]]:
    """Return a pose (4, 4), metres, as the quaternion and the position of a node of the view."""
    return {"wxyz": rotation_to_quaternion(T[:3, :3]), "position": UNITS_PER_M * T[:3, 3]}


def from_view(handle: Any) -> Pose:
    """Return the pose (4, 4), metres, of a node of the view."""
    return make_transform(quaternion_to_rotation(handle.wxyz), np.asarray(handle.position, float) / UNITS_PER_M)


class SceneView:
    """Draws into the scene of one visitor."""

    def __init__(self, client: ClientHandle) -> None:
        self.client, self.scene = client, client.scene
        self.finger_gizmo: TransformControlsHandle | None = None
        self.prior_gizmo: TransformControlsHandle | None = None
        self._mesh: TriangleMesh | None = None
        self._object: Any = None
        self._gel: Any = None
        self._finger: Any = None
        self.scene.set_up_direction("+z")

    # object and finger

    def show_object(self, obj: ObjectModel, geometry: SensorGeometry) -> None:
        """Draw another object, or the same one for another sensor, and look at it. All else is removed."""
        self.scene.reset()
        self._gel = self._finger = self.finger_gizmo = self.prior_gizmo = None
        mesh = obj.mesh if len(obj.mesh.faces) <= MOST_FACES else simplify_mesh(obj.mesh, MOST_FACES)
        self._mesh = mesh
        self._object = self._add_mesh("/object", mesh, STEEL)
        self._look_at(mesh, geometry)

    def _add_mesh(self, name: str, mesh: TriangleMesh, colour: tuple[int, int, int], **options: Any) -> Any:
        vertices = np.asarray(UNITS_PER_M * mesh.vertices_m, np.float32)
        return self.scene.add_mesh_simple(
            name,
            vertices,
            mesh.faces.astype(np.uint32),
            color=colour,
            flat_shading=True,
            side="double",
            **PLAIN,
            **options,
        )

    def _look_at(self, mesh: TriangleMesh, geometry: SensorGeometry) -> None:
        """Look at the middle of the object, in the part of the view that the controls leave free."""
        camera, middle = self.client.camera, UNITS_PER_M * mesh.corners_m.mean(axis=0)
        size = UNITS_PER_M * (np.linalg.norm(mesh.extents_m) + max(np.ptp(geometry.rectangle[:2]), 0.01))
        if camera.aspect < PHONE_ASPECT:
            size *= PHONE_AWAY
            middle = middle - 0.5 * SHEET * measure_height(size * FROM, camera.fov)
        camera.near, camera.far = NEAR, FAR
        camera.position = middle + size * FROM
        camera.look_at = middle  # after the position, which moves this point, too

    def add_finger_gizmo(self, T_base_sensor: Pose, geometry: SensorGeometry) -> TransformControlsHandle:
        """Add the gizmo that drags the finger. Its origin is the middle of the gel, and its z axis points out of it."""
        self.finger_gizmo = self.scene.add_transform_controls(
            "/gizmo",
            scale=self._size_gizmo(geometry),
            depth_test=False,
            opacity=0.85,
            **to_view(T_base_sensor @ make_translation(geometry.gel_middle_m)),
        )
        return self.finger_gizmo

    def _size_gizmo(self, geometry: SensorGeometry) -> float:
        x0, x1, y0, y1 = geometry.rectangle
        return UNITS_PER_M * max(x1 - x0, y1 - y0)

    def read_finger(self, geometry: SensorGeometry) -> Pose:
        """Return the finger's pose `T_base_sensor` (4, 4), metres, from its gizmo."""
        return from_view(self.finger_gizmo) @ invert(make_translation(geometry.gel_middle_m))

    def move_finger_gizmo(self, T_base_sensor: Pose, geometry: SensorGeometry) -> None:
        """Move the gizmo to the finger."""
        for name, value in to_view(T_base_sensor @ make_translation(geometry.gel_middle_m)).items():
            setattr(self.finger_gizmo, name, value)

    def show_press(self, press: Press) -> None:
        """Draw the finger where it is pressed, with its gel's surface."""
        vertices, faces = press.build_gel_surface()
        vertices *= UNITS_PER_M
        if self._finger is None:
            self._finger = self.scene.add_frame("/finger", show_axes=False, **to_view(press.T_base_sensor))
            self._gel = self.scene.add_mesh_simple(
                "/finger/gel", vertices, faces, color=GEL, opacity=0.75, side="double", **PLAIN
            )
            self._add_box("/finger/housing", press.geometry, HOUSING, 0.35)
        with self.client.atomic():
            for name, value in to_view(press.T_base_sensor).items():
                setattr(self._finger, name, value)
            self._gel.vertices = vertices

    def _add_box(self, name: str, geometry: SensorGeometry, colour: tuple[int, int, int], opacity: float) -> None:
        """Add a sensor's housing, which lies behind the gel, in the sensor frame."""
        housing = np.asarray(UNITS_PER_M * DrawnSensor(geometry).housing_m, np.float32).reshape(-1, 3)
        housing[:, 2] -= 1e-3 * UNITS_PER_M * 2  # behind the deepest point of a pressed gel
        faces = np.arange(len(housing), dtype=np.uint32).reshape(-1, 3)
        self.scene.add_mesh_simple(
            name, housing, faces, color=colour, opacity=opacity, flat_shading=True, side="double", **PLAIN
        )

    # touches and results

    def show_touches(self, touches: tuple[Touch, ...]) -> None:
        """Draw the outlines of all touches whose sensor poses are known, with their numbers."""
        self.scene.remove_by_name("/touches")
        for number, touch in enumerate(touches, 1):
            if touch.T_base_sensor is None:
                continue
            name = f"/touches/{number}"
            self.scene.add_frame(name, show_axes=False, **to_view(touch.T_base_sensor))
            lines = [UNITS_PER_M * line for line in DrawnSensor.of(touch).outlines_m]
            pairs = [np.stack([line[:-1], line[1:]], axis=1) for line in lines]
            if pairs:
                self.scene.add_line_segments(
                    f"{name}/outline", np.concatenate(pairs).astype(np.float32), colors=TOUCHED, thickness=0.03
                )
            self.scene.add_label(f"{name}/number", str(number), position=UNITS_PER_M * touch.geometry.gel_middle_m)

    def clear_result(self) -> None:
        """Remove hypotheses, ellipsoid and next touch."""
        self._object.visible = True
        for name in ("/poses", "/cloud", "/ellipsoid", "/next"):
            self.scene.remove_by_name(name)

    def show_result(self, found: Localization, chosen: int) -> None:
        """Draw the probable hypotheses, coloured by probability, and the chosen one opaque, with its ellipsoid.

        The object at rest is hidden if a touch was not simulated, because it rests elsewhere then.
        """
        self.clear_result()
        self._object.visible = all(touch.T_sensor_object is not None for touch in found.touches)
        drawn = DrawnScene.of(found, in_base=True)
        for number, (T, probability) in enumerate(zip(drawn.poses, drawn.probabilities, strict=True)):
            if self._mesh is not None and (number == chosen or probability >= LEAST_SHOWN):
                colour = colour_probability(float(probability), float(drawn.probabilities.max()))
                look = {"scale": COVERING} if number == chosen else {"opacity": 0.12}
                self._add_mesh(f"/poses/{number}", self._mesh, colour, **look, **to_view(T))
        self._show_cloud(drawn)
        self._show_ellipsoid(drawn, chosen)

    def _show_cloud(self, drawn: DrawnScene) -> None:
        """Draw the middle of the object at the most probable poses of the posterior."""
        T, p = drawn.likely_poses[:MOST_LIKELY], drawn.likely[:MOST_LIKELY]
        places = T[:, :3, :3] @ drawn.mesh.centroid_m + T[:, :3, 3]
        colours = np.array([colour_probability(float(one), float(p[0])) for one in p], np.uint8)
        self.scene.add_point_cloud(
            "/cloud", np.asarray(UNITS_PER_M * places, np.float32), colours, point_size=0.06, point_shape="circle"
        )

    def _show_ellipsoid(self, drawn: DrawnScene, chosen: int) -> None:
        covariance, ellipsoid = drawn.covariances[chosen], drawn.find_ellipsoid(chosen)
        if covariance is None or ellipsoid is None:
            return
        half_m = ellipsoid.half_axes_m * choose_magnification(covariance)
        self.scene.add_icosphere(
            "/ellipsoid",
            1.0,
            (230, 73, 128),
            scale=tuple(float(UNITS_PER_M * max(v, 1e-5)) for v in half_m),
            opacity=0.6,
            **to_view(make_transform(ellipsoid.axes, ellipsoid.centre_m)),
        )

    def show_next(self, rated: RatedApproach, geometry: SensorGeometry) -> None:
        """Draw the sensor at the start of the next touch, and a line along its way."""
        self.scene.remove_by_name("/next")
        self.scene.add_frame("/next", show_axes=False, **to_view(rated.approach.T_base_sensor))
        self._add_box("/next/sensor", geometry, NEXT, 0.5)
        start = geometry.gel_middle_m
        way_m = np.nanmin(rated.travel_m) if np.isfinite(rated.travel_m).any() else rated.approach.travel_m
        line = np.stack([start, start + np.array([0, 0, way_m])])[None]
        self.scene.add_line_segments(
            "/next/way", np.asarray(UNITS_PER_M * line, np.float32), colors=NEXT, thickness=0.06
        )

    # the prior

    def add_prior(self, T_base_object: Pose) -> TransformControlsHandle:
        """Draw a second object, with a gizmo that drags it roughly into place."""
        assert self._mesh is not None
        size = UNITS_PER_M * 0.6 * float(self._mesh.extents_m.max())
        self.prior_gizmo = self.scene.add_transform_controls(
            "/prior", scale=size, depth_test=False, opacity=0.7, **to_view(T_base_object)
        )
        self._add_mesh("/prior/object", self._mesh, EXPECTED, opacity=0.35)
        return self.prior_gizmo

    def remove_prior(self) -> None:
        """Remove the second object."""
        self.scene.remove_by_name("/prior")
        self.prior_gizmo = None


def measure_height(away: NDArray[np.float64], fov_rad: float) -> NDArray[np.float64]:
    """Return the vector (3,) from the bottom to the top of a camera's view, in the plane of the point it looks at.

    The camera is at `away` (3,) from the point, and its up direction is +z.
    """
    forward = -away / np.linalg.norm(away)
    up = np.array([0.0, 0.0, 1.0]) - forward[2] * forward
    return np.asarray(2 * np.linalg.norm(away) * np.tan(0.5 * fov_rad) * up / np.linalg.norm(up))


def choose_magnification(covariance: NDArray[np.float64]) -> float:
    """Return the magnification, 1 to 1000, that makes the ellipsoid of a covariance (6, 6) visible."""
    largest_m = SIGMAS * float(np.sqrt(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 1e-18)))
    return float(10.0 ** np.clip(np.floor(np.log10(LARGEST_M / largest_m)), 0, 3))
