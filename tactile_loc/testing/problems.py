"""Scenes and touches with known true poses for the checks, from small surfaces, small cameras and their own renderer.

The main object is a block with different features. Candidates are near its true pose.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import (
    Float32,
    Floats,
    Poses,
    make_transform,
    make_translation,
    rotation_about,
    transform_points,
)
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.simulate.listed_training import ListedProblem
from tactile_loc.simulate.place_training import PlaceProblem
from tactile_loc.slots.encoder import TrainingProblem
from tactile_loc.slots.registry import registry
from tactile_loc.slots.renderer import Renderer
from tactile_loc.testing.contract import share

_ROUNDING, _EDGE_ON = 1e-9, 1e-16  # of weights; least area of a triangle in the image


class ReferenceRenderer(Renderer):
    """A renderer that draws one triangle after the other, in closed form and double precision. Use it for small meshes.

    In the image, the three weights of a triangle's corners are linear, and so is z, or 1/z for a pinhole.
    """

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths z (N, H, W), metres, at pixel centres for poses (N, 4, 4).

        Triangles entirely beyond the contact band, or behind a pinhole, are left out. A ray that meets no other
        triangle has the depth inf.
        """
        depth = np.full((len(T_sensor_object), *geometry.shape), np.inf, np.float32)
        for picture, T in zip(depth, T_sensor_object, strict=True):
            triangles = mesh.triangles_m @ T[:3, :3].T + T[:3, 3]
            nearest = triangles[..., 2].min(axis=1)
            behind = geometry.is_pinhole & (nearest <= 0)
            _draw(triangles[(nearest <= geometry.standoff_m + geometry.max_depth_m) & ~behind], geometry, picture)
        return depth


def _draw(triangles_m: Floats, geometry: SensorGeometry, picture: Float32) -> None:
    """Draw triangles (F, 3, 3) into a picture (H, W) of depths, where they are nearer."""
    x, y = geometry.pixel_slopes
    corners, z = triangles_m.swapaxes(1, 2).copy(), triangles_m[..., 2]
    corners[:, :2] /= z[:, None] if geometry.is_pinhole else 1.0
    corners[:, 2] = 1.0
    seen = np.abs(np.linalg.det(corners)) > _EDGE_ON
    for at, depths, weigh in zip(corners[seen], z[seen], np.linalg.inv(corners[seen]), strict=True):
        across, down = (_find_between(slopes, ends) for slopes, ends in ((x, at[0]), (y, at[1])))
        weights = weigh[:, :1, None] * x[across] + weigh[:, 1:2, None] * y[down, None] + weigh[:, 2:, None]
        if geometry.is_pinhole:
            hit = 1.0 / np.einsum("c,crk->rk", 1.0 / depths, weights)
        else:
            hit = np.einsum("c,crk->rk", depths, weights)
        part = picture[down, across]
        np.minimum(part, hit, out=part, where=(weights >= -_ROUNDING).all(axis=0), casting="same_kind")


def _find_between(slopes: Floats, ends: Floats) -> slice:
    """Return the ascending slopes that lie between the least and the greatest of the ends."""
    return slice(*np.searchsorted(slopes, [ends.min() - _ROUNDING, ends.max() + _ROUNDING]))


def extrude(outline_m: Floats, z_m: tuple[float, float]) -> TriangleMesh:
    """Return a closed prism along z over a convex outline (K, 2), metres, whose corners are listed anticlockwise."""
    count = len(outline_m)
    i, j, fan = np.arange(count), np.roll(np.arange(count), -1), np.arange(1, count - 1)
    walls = [np.column_stack([i, j, i + count]), np.column_stack([j, j + count, i + count])]
    caps = [np.column_stack([0 * fan, fan + 1, fan]), np.column_stack([0 * fan, fan, fan + 1]) + count]
    rims = [np.column_stack([outline_m, np.full(count, z)]) for z in z_m]
    return TriangleMesh(np.concatenate(rims), np.concatenate(walls + caps))


def make_box(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> TriangleMesh:
    """Return a closed box between two corners, metres."""
    (x0, y0, z0), (x1, y1, z1) = low_m, high_m
    return extrude(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), (z0, z1))


def make_cylinder(radius_m: float, z_m: tuple[float, float], sides: int = 16) -> TriangleMesh:
    """Return a closed prism about the z axis, metres. Its `sides` side faces are inside the cylinder."""
    angle = 2 * np.pi * np.arange(sides) / sides
    return extrude(radius_m * np.column_stack([np.cos(angle), np.sin(angle)]), z_m)


def transform_mesh(mesh: TriangleMesh, T: Floats) -> TriangleMesh:
    """Return the mesh transformed by T (4, 4), metres."""
    return TriangleMesh(transform_points(T, mesh.vertices_m), mesh.faces)


def mirror_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mirror image of a mesh, which has -x in place of x. Outward normals stay outward."""
    return TriangleMesh(mesh.vertices_m * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1].copy())


def copy_mesh(mesh: TriangleMesh) -> TriangleMesh:
    """Return a copy of the mesh with its own memory, for checks that inputs are not changed."""
    return TriangleMesh(mesh.vertices_m.copy(), mesh.faces.copy())


def scale_mesh(mesh: TriangleMesh, factor: float) -> TriangleMesh:
    """Return the mesh scaled by a factor about the origin."""
    return TriangleMesh(mesh.vertices_m * factor, mesh.faces)


def join_meshes(*meshes: TriangleMesh) -> TriangleMesh:
    """Return several surfaces as one mesh. The surfaces may intersect."""
    starts = np.cumsum([0, *(len(m.vertices_m) for m in meshes[:-1])])
    faces = [m.faces + start for m, start in zip(meshes, starts, strict=True)]
    return TriangleMesh(np.concatenate([m.vertices_m for m in meshes]), np.concatenate(faces))


@share
def make_stepped_block() -> TriangleMesh:
    """Return a block of 16 x 10 x 6 mm without symmetry. Its underside (towards -z) has a boss, a ramp and a post.

    Each feature touches at a different press depth, from 0 (boss) to 1.2 mm (body).
    """
    body = make_box((-0.008, -0.005, 0.0012), (0.008, 0.005, 0.006))
    boss = make_box((-0.007, -0.004, 0.0), (-0.002, 0.001, 0.002))
    post = transform_mesh(make_cylinder(0.0015, (0.0005, 0.003)), make_translation([0.004, -0.0025, 0.0]))
    return join_meshes(body, boss, _make_ramp(), post)


def _make_ramp() -> TriangleMesh:
    wedge = make_box((0.001, 0.001, 0.0002), (0.007, 0.004, 0.002))
    x, y, z = wedge.vertices_m.T
    sloping = np.where(z < 0.001, z + (x - 0.001) / 6, z)
    return TriangleMesh(np.column_stack([x, y, sloping]), wedge.faces)


@share
def make_ball(radius_m: float = 0.008, rounds: int = 5) -> TriangleMesh:
    """Return a sphere about the origin, metres. It is an octahedron whose faces are divided in four `rounds` times."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    signs = np.array([[x, y, z] for x in (0, 3) for y in (0, 3) for z in (0, 3)])
    triangles = corners[signs + np.arange(3)]
    for _ in range(rounds):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = a + b, b + c, c + a
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(p, axis=1) for p in parts])
        triangles /= np.linalg.norm(triangles, axis=-1, keepdims=True)
    return TriangleMesh(radius_m * triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def make_plate(half_m: float = 0.1) -> TriangleMesh:
    """Return a square in the plane z = 0, metres, without thickness."""
    corners = half_m * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def make_overhang() -> TriangleMesh:
    """Return a foot, 0.3 mm thick, 1.2 mm in front of a plate. From beside, a pinhole camera sees behind the foot."""
    foot = make_box((0.005, -0.006, 0.0), (0.009, 0.006, 0.0003))
    return join_meshes(foot, make_box((-0.002, -0.008, 0.0015), (0.012, 0.008, 0.004)))


# CAMERAS are square and centred, so that a quarter turn maps the image to itself. LOPSIDED_CAMERAS have no symmetry.
# All cameras see about 25 mm of the surface and have a maximal depth of 2 mm.
CAMERAS = {
    "orthographic": SensorGeometry("orthographic", 64, 64, 2500.0, 2500.0, 32.0, 32.0, 0.010, 0.002),
    "pinhole": SensorGeometry("pinhole", 64, 64, 62.5, 62.5, 32.0, 32.0, 0.025, 0.002),
}
LOPSIDED_CAMERAS = {
    "orthographic": SensorGeometry("orthographic", 80, 56, 3100.0, 2400.0, 37.3, 30.1, 0.021, 0.002),
    "pinhole": SensorGeometry("pinhole", 80, 56, 65.0, 50.0, 37.3, 30.1, 0.021, 0.002),
}

POSE = (0.0012, -0.0009, np.radians(25.0))  # the pressed block's x, y, metres, and yaw
OFFSETS = ((0.0008, -0.0006, 0.0), (-0.0007, 0.0, np.radians(4.0)), (0.0, 0.0009, np.radians(-5.0)))


@dataclass(frozen=True, eq=False)
class PressedBlock:
    """A touch, its scene, and the true T_sensor_object (4, 4), metres."""

    scene: Scene
    touch: Touch
    truth: Floats

    def make_candidate(self, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Candidate:
        """Return the true pose moved by (x, y, yaw), metres and radians, and brought to contact, as a candidate."""
        x, y, yaw = offset
        moved = make_transform(self.truth[:3, :3] @ rotation_about([0, 0, 1], yaw), self.truth[:3, 3] + [x, y, 0.0])
        return Candidate(self.scene.bring_to_contact(moved[None])[0][0], index=0, log_p=0.0)

    def measure_error_m(self, pose: Candidate | RefinedPose) -> float:
        """Return the root mean square distance, metres, of the block's surface points from their true positions."""
        return float(PoseMetric(self.scene.object).distance(pose.T_sensor_object, self.truth))


@share
def make_block(scale: float = 1.0) -> ObjectModel:
    """Return the stepped block as an object without symmetry, scaled by a factor."""
    return make_plain_object("stepped block", scale_mesh(make_stepped_block(), scale))


def make_plain_object(name: str, mesh: TriangleMesh) -> ObjectModel:
    """Return a mesh as an object without symmetry."""
    return ObjectModel(name, mesh, SymmetryGroup.parse("none", mesh.centroid_m))


@share
def make_prism() -> ObjectModel:
    """Return a six-sided prism, 10 mm across corners and 8 mm long, with its twelve rotations `z6*x2`."""
    mesh = make_cylinder(0.005, (-0.004, 0.004), sides=6)
    return ObjectModel("prism", mesh, SymmetryGroup.parse("z6*x2", mesh.centroid_m))


@share
def make_mirrored_block() -> ObjectModel:
    """Return the mirror image of the block. No rotation maps it to the block."""
    return make_plain_object("mirrored block", mirror_mesh(make_stepped_block()))


@share
def make_rod() -> ObjectModel:
    """Return a rod of 60 x 8 x 6 mm, declared without symmetry. Its width over a sensor depends on its yaw."""
    return make_plain_object("rod", make_box((-0.030, -0.004, -0.003), (0.030, 0.004, 0.003)))


def scale_sensor(geometry: SensorGeometry, scale: float) -> SensorGeometry:
    """Return the sensor with all its lengths scaled by a factor. The image keeps its size in pixels."""
    k = 1.0 if geometry.is_pinhole else scale
    return dataclasses.replace(
        geometry,
        fx=geometry.fx / k,
        fy=geometry.fy / k,
        standoff_m=geometry.standoff_m * scale,
        max_depth_m=geometry.max_depth_m * scale,
    )


@share
def make_block_scene(camera: str = "orthographic", scale: float = 1.0) -> Scene:
    """Return a scene with the block, one of the CAMERAS, both scaled by a factor, and the reference renderer."""
    return Scene(make_block(scale), scale_sensor(CAMERAS[camera], scale), ReferenceRenderer())


def press_block(camera: str = "orthographic", scale: float = 1.0, press: float = 1.0) -> PressedBlock:
    """Return the block pressed at POSE by the share `press` (0 to 1) of the maximal depth."""
    x, y, yaw = POSE
    return _press(make_block_scene(camera, scale), make_planar_pose(x * scale, y * scale, yaw), press)


def press_prism(camera: str = "orthographic") -> PressedBlock:
    """Return the prism pressed at POSE, with one end down.

    Its twelve symmetric poses explain the touch equally well.
    """
    return _press(Scene(make_prism(), CAMERAS[camera], ReferenceRenderer()), make_planar_pose(*POSE), 1.0)


def _press(scene: Scene, T_sensor_object: Floats, press: float) -> PressedBlock:
    scene = scene.press(press * scene.geometry.max_depth_m)
    truth = scene.bring_to_contact(T_sensor_object[None])[0][0]
    return PressedBlock(scene, make_touch(scene, truth, scene.geometry.indentation_m), truth)


def make_planar_pose(x_m: float, y_m: float, yaw_rad: float) -> Floats:
    """Return the pose (4, 4), metres, at x, y and yaw, with z = 0. The features of the block face the sensor."""
    return make_transform(rotation_about([0, 0, 1], yaw_rad), [x_m, y_m, 0.0])


def make_touch(scene: Scene, T_sensor_object: Floats, press_depth_m: float) -> Touch:
    """Return the touch of the object at a pose (4, 4), pressed in by `press_depth_m` metres."""
    pressed = scene.press(press_depth_m)
    T = pressed.bring_to_contact(T_sensor_object[None])[0]
    shape = ContactShape(pressed.render_gel_depths(T)[0], press_depth_m)
    return Touch(shape, pressed.geometry, "pressed block", T_sensor_object=T[0])


def replace_depth(touch: Touch, depth_m: Float32) -> Touch:
    """Return the touch with other depths (H, W), metres."""
    return dataclasses.replace(touch, contact_shape=ContactShape(depth_m, touch.press_depth_m))


def make_contact_poses(scene: Scene, count: int = 6) -> Poses:
    """Return clearly different contact poses (count, 4, 4), metres, which are on a circle and have different yaws."""
    angles = 2 * np.pi * np.arange(count) / count
    poses = [make_planar_pose(0.003 * np.cos(a), 0.003 * np.sin(a), 1.7 * a) for a in angles]
    return scene.bring_to_contact(np.stack(poses))[0]


def make_small_grid(scene: Scene | None = None) -> PoseGrid:
    """Return a grid of 40 random contact poses of the object in a scene, by default the block's."""
    rng = np.random.default_rng(0)
    x, y, yaw = rng.uniform(-0.004, 0.004, 40), rng.uniform(-0.004, 0.004, 40), rng.uniform(0, 2 * np.pi, 40)
    scene = scene or make_block_scene()
    poses = scene.bring_to_contact(np.stack([make_planar_pose(*p) for p in zip(x, y, yaw, strict=True)]))[0]
    return PoseGrid(poses, PoseMetric(scene.object))


def make_training_problem() -> TrainingProblem:
    """Return a tiny problem for training an encoder before its checks, with the checks' object and camera."""
    scene = Scene(make_block(), LOPSIDED_CAMERAS["orthographic"], ReferenceRenderer())
    grid = make_small_grid(scene)
    shapes = scene.render_contact_depths(grid.T_sensor_object, grid=True)
    sampler = registry().create("grid", "face", {"spacing_mm": 4.0, "face": "-z"})
    return ListedProblem(grid, scene, sampler, lambda: iter([shapes]))


def make_place_training_problem() -> PlaceProblem:
    """Return a tiny training problem with an object's places, for the checks' object and camera."""
    scene = Scene(make_block(), LOPSIDED_CAMERAS["orthographic"], ReferenceRenderer())
    sampler = registry().create("grid", "whole", {"directions": 100})
    return PlaceProblem(sampler.places(scene.object, Progress()), scene, sampler)
