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
    Palette,
    RatedApproach,
    SensorGeometry,
    Touch,
    TriangleMesh,
    Verdict,
    simplify_mesh,
)
from tactile_loc.commands import format_percent
from tactile_loc.plugin.helpers import (
    invert,
    make_transform,
    make_translation,
    quaternion_to_rotation,
    rotation_to_quaternion,
)

from tactile_loc_app.virtual_finger import Pose, Press

if TYPE_CHECKING:
    from viser import ClientHandle, TransformControlsHandle

UNITS_PER_M = 100.0  # one unit of the view is 1 cm, because cameras of the view do not come near small objects
MOST_FACES = 20_000  # triangles of the object in the view
PALETTE = Palette()


def _mix(colour: str) -> tuple[int, ...]:
    """Return a colour of the palette as red, green and blue, 0 to 255."""
    return tuple(round(255 * share) for share in Palette.rgb(colour))


BEST, TRUTH, REST, GEL = map(_mix, (PALETTE.best, PALETTE.truth, "#a9b1bb", PALETTE.gel))
HOUSING, TOUCHED, NEXT, EXPECTED = map(_mix, (PALETTE.housing, PALETTE.contact, PALETTE.next, PALETTE.expected))
SKY = np.linspace([236, 241, 246], [252, 253, 254], 64)[::-1, None].astype(np.uint8)  # behind the scene
GIZMO = 0.8  # length of the finger's arrows, in widths of the gel
GRID_MM, FLOOR = 10.0, 4.0  # cells of the floor, and the floor's side in sizes of the object
OUTLINE = 0.006  # width of the outline of the true pose, in sizes of the object
LARGEST_M = 2e-3  # half axis of a drawn ellipsoid, at most; a small ellipsoid is magnified by a power of ten
SIGMAS = 2.0  # standard deviations of the half axes of ellipsoids in a DrawnScene
MOST_LIKELY = 500  # drawn poses of the posterior
PLAIN: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}
SUN = (5.0, -2.0, 6.0)  # where the light comes from
LEAST_SHOWN = 0.01  # probability of a hypothesis that is drawn although it is not chosen
NEAR, FAR = 0.1, 500.0  # range that the camera of the view sees, in units of the view
FROM = np.array([0.52, -0.70, 0.49])  # direction, of length 1, from which the object is seen at first
LABEL_M = 4e-3  # distance of a touch's number from the gel, times the number
ROOM = 1.1  # space around the object when it is framed
PHONE_ASPECT = 0.6  # of a narrow page, on which the controls are a drawer
COVERED, PHONE_COVERED = (0.08, 0.02), (0.13, 0.2)  # shares of the view's height, by the card above and drawer below
GHOST, MOST_WEIGHTS = 0.35, 5  # largest opacity of a pose that is not chosen, and largest number of written weights


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
        self._truth: Any = None
        self._gel: Any = None
        self._finger: Any = None
        self.scene.set_up_direction("+z")
        self.scene.set_background_image(SKY.repeat(2, axis=1), format="png")
        self.scene.configure_environment_map(None)  # slow without a GPU, as are the shadows of the default lights
        self.scene.configure_default_lights(False, cast_shadow=False)

    # object and finger

    def show_object(self, obj: ObjectModel, geometry: SensorGeometry) -> None:
        """Draw another object, or the same one for another sensor, and look at it. All else is removed."""
        self.scene.reset()
        self._gel = self._finger = self.finger_gizmo = self.prior_gizmo = None
        mesh = obj.mesh if len(obj.mesh.faces) <= MOST_FACES else simplify_mesh(obj.mesh, MOST_FACES)
        self._mesh = mesh
        self.scene.add_light_hemisphere("/sky", ground_color=(180, 185, 195), intensity=1.6)
        self.scene.add_light_directional("/sun", color=(255, 250, 240), intensity=2.6, position=SUN)
        self._object = self._add_mesh("/object", mesh, REST)
        self._add_outline(mesh)
        self._add_floor(mesh)
        self._look_at(mesh, geometry)

    def _add_outline(self, mesh: TriangleMesh) -> None:
        """Add the outline of the object at rest: the back of its surface, moved outwards. It is hidden at first."""
        width_m = OUTLINE * float(np.linalg.norm(mesh.extents_m))
        grown = TriangleMesh(mesh.vertices_m + width_m * mesh.vertex_normals, mesh.faces)
        self._truth = self._add_mesh("/truth", grown, TRUTH, side="back", flat_shading=False, visible=False)

    def _add_floor(self, mesh: TriangleMesh) -> None:
        """Add a floor below the object at rest, with a grid in mm."""
        low, high = UNITS_PER_M * mesh.corners_m.min(axis=0), UNITS_PER_M * mesh.corners_m.max(axis=0)
        cell = 1e-3 * UNITS_PER_M * GRID_MM
        side = cell * np.ceil(FLOOR * np.linalg.norm(high - low) / cell)
        middle = [*(0.5 * (low + high))[:2], low[2] - 0.02]
        self.scene.add_grid(
            "/floor",
            side,
            side,
            position=middle,
            cell_size=cell,
            section_size=5 * cell,
            cell_color=(214, 220, 227),
            section_color=(184, 193, 203),
            fade_distance=2.5 * side,
        )
        corner = np.array([0.5 * high[0] + 0.5 * low[0], low[1] - 0.25 * side / FLOOR, low[2]])
        self.scene.add_label("/floor/size", f"{GRID_MM:g} mm grid", position=corner - middle, anchor="center-center")

    def _add_mesh(self, name: str, mesh: TriangleMesh, colour: tuple[int, ...], **options: Any) -> Any:
        look = {"flat_shading": True, "side": "double", **PLAIN, **options}
        vertices = np.asarray(UNITS_PER_M * mesh.vertices_m, np.float32)
        return self.scene.add_mesh_simple(name, vertices, mesh.faces.astype(np.uint32), color=colour, **look)

    def _look_at(self, mesh: TriangleMesh, geometry: SensorGeometry) -> None:
        """Look at the object and the finger, in the part of the view that the card and the controls leave free."""
        camera = self.client.camera
        covered = PHONE_COVERED if camera.aspect < PHONE_ASPECT else COVERED
        finger_m = 0.5 * max(np.ptp(geometry.rectangle[:2]), 0.01)
        target, away = frame_points(
            UNITS_PER_M * mesh.corners_m, UNITS_PER_M * finger_m, np.tan(0.5 * camera.fov), camera.aspect, covered
        )
        camera.near, camera.far = NEAR, FAR
        camera.position = target + away * FROM
        camera.look_at = target  # after the position, which moves this point, too

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
        return GIZMO * UNITS_PER_M * max(x1 - x0, y1 - y0)

    def read_finger(self, geometry: SensorGeometry) -> Pose:
        """Return the finger's pose `T_base_sensor` (4, 4), metres, from its gizmo."""
        return from_view(self.finger_gizmo) @ invert(make_translation(geometry.gel_middle_m))

    def move_finger_gizmo(self, T_base_sensor: Pose, geometry: SensorGeometry) -> None:
        """Move the gizmo to the finger."""
        for name, value in to_view(T_base_sensor @ make_translation(geometry.gel_middle_m)).items():
            setattr(self.finger_gizmo, name, value)

    def show_finger(self, shown: bool) -> None:
        """Show or hide the finger and its gizmo."""
        for handle in (self._finger, self.finger_gizmo):
            if handle is not None:
                handle.visible = shown

    def show_press(self, press: Press) -> None:
        """Draw the finger where it is pressed, with its gel's surface."""
        vertices, faces = press.build_gel_surface()
        vertices *= UNITS_PER_M
        if self._finger is None:
            shown = self.finger_gizmo is None or self.finger_gizmo.visible
            self._finger = self.scene.add_frame(
                "/finger", show_axes=False, visible=shown, **to_view(press.T_base_sensor)
            )
            self._gel = self.scene.add_mesh_simple(
                "/finger/gel", vertices, faces, color=GEL, opacity=0.9, side="double", **PLAIN
            )
            self._add_body("/finger/body", press.geometry, HOUSING, 0.75)
        with self.client.atomic():
            for name, value in to_view(press.T_base_sensor).items():
                setattr(self._finger, name, value)
            self._gel.vertices = vertices

    def _add_body(self, name: str, geometry: SensorGeometry, colour: tuple[int, ...], opacity: float) -> None:
        """Add a sensor's housing and body, which lie behind the gel, in the sensor frame."""
        sensor = DrawnSensor(geometry)
        parts = np.concatenate([sensor.housing_m, sensor.body_m]).reshape(-1, 3)
        solid = np.asarray(UNITS_PER_M * parts, np.float32)
        solid[:, 2] -= 1e-3 * UNITS_PER_M * 2  # behind the deepest point of a pressed gel
        faces = np.arange(len(solid), dtype=np.uint32).reshape(-1, 3)
        self.scene.add_mesh_simple(name, solid, faces, color=colour, opacity=opacity, flat_shading=True, **PLAIN)

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
            place = touch.geometry.gel_middle_m - [0, 0, LABEL_M * number]  # numbers of near touches do not overlap
            self.scene.add_label(f"{name}/number", str(number), position=UNITS_PER_M * place)

    def clear_result(self) -> None:
        """Remove hypotheses, ellipsoid and next touch."""
        self._object.visible, self._truth.visible = True, False
        for name in ("/poses", "/cloud", "/ellipsoid", "/next"):
            self.scene.remove_by_name(name)

    def show_result(self, found: Localization, chosen: int) -> None:
        """Draw the probable hypotheses, the chosen one solid and others as ghosts, with their weights.

        The object at rest becomes an outline. It is hidden if a touch was not simulated, because it rests elsewhere
        then.
        """
        self.clear_result()
        self._object.visible = False
        self._truth.visible = all(touch.T_sensor_object is not None for touch in found.touches)
        drawn, mesh = DrawnScene.of(found, in_base=True), self._mesh
        assert mesh is not None
        p = drawn.probabilities
        shown = [number for number in range(len(p)) if number == chosen or p[number] >= LEAST_SHOWN]
        for number in shown:
            look = {} if number == chosen else {"opacity": GHOST * float(np.sqrt(p[number] / p.max()))}
            self._add_mesh(f"/poses/{number}", mesh, BEST, **look, **to_view(drawn.poses[number]))
        if found.verdict is not Verdict.CERTAIN:
            if len(shown) > 1:
                self._write_weights(drawn, mesh, shown[:MOST_WEIGHTS])
            self._show_cloud(drawn)
        self._show_ellipsoid(drawn, chosen)

    def _write_weights(self, drawn: DrawnScene, mesh: TriangleMesh, shown: list[int]) -> None:
        """Write the probabilities beside the vertex of the object whose places differ most between the poses."""
        T = drawn.poses[shown]
        places = T[:, :3, :3] @ mesh.vertices_m.T + T[:, :3, 3:]
        vertex = int(places.var(axis=0).sum(axis=0).argmax())
        for number, place in zip(shown, places[:, :, vertex], strict=True):
            text = format_percent(float(drawn.probabilities[number]))
            self.scene.add_label(f"/poses/weight-{number}", text, position=UNITS_PER_M * place, anchor="center-center")

    def _show_cloud(self, drawn: DrawnScene) -> None:
        """Draw the middle of the object at the most probable poses of the posterior."""
        T = drawn.likely_poses[:MOST_LIKELY]
        places = T[:, :3, :3] @ drawn.mesh.centroid_m + T[:, :3, 3]
        self.scene.add_point_cloud(
            "/cloud", np.asarray(UNITS_PER_M * places, np.float32), BEST, point_size=0.06, point_shape="circle"
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
        self._add_body("/next/sensor", geometry, NEXT, 0.35)
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


def frame_points(
    points: NDArray[np.float64], margin: float, slope: float, aspect: float, covered: tuple[float, float]
) -> tuple[NDArray[np.float64], float]:
    """Return the point (3,) that a camera in the direction FROM looks at to see points (N, 3), and its distance.

    `margin` is free around the points. `slope` is the tangent of half of the view's height, and `covered` are the
    shares of this height that are hidden above and below.
    """
    right = np.cross([0.0, 0.0, 1.0], FROM) / np.hypot(*FROM[:2])
    axes = np.stack([right, np.cross(FROM, right), FROM])
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    wide, tall, deep = ROOM * (0.5 * (high - low) + margin)
    above, below = covered
    away = float(deep + max(wide / aspect, tall / (1 - above - below)) / slope)
    middle = 0.5 * (low + high) + np.array([0.0, (above - below) * away * slope, 0.0])
    return middle @ axes, away


def choose_magnification(covariance: NDArray[np.float64]) -> float:
    """Return the magnification, 1 to 1000, that makes the ellipsoid of a covariance (6, 6) visible."""
    largest_m = SIGMAS * float(np.sqrt(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 1e-18)))
    return float(10.0 ** np.clip(np.floor(np.log10(LARGEST_M / largest_m)), 0, 3))
