"""Scenes and touches with known true poses for the checks, from small surfaces, small cameras and their own renderer.

The main object is a block with different features. Candidates are near its true pose.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Poses, make_transform, rotation_about, transform_points
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

Array = NDArray[np.float64]

_BOX_FACES = np.array(
    [
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 4],
        [1, 5, 4],
        [2, 6, 3],
        [3, 6, 7],
        [0, 4, 2],
        [2, 4, 6],
        [1, 3, 5],
        [3, 7, 5],
    ]
)
_ROUNDING = 1e-9
RAYS = 256  # number of rays intersected at once


class ReferenceRenderer(Renderer):
    """A renderer that intersects every ray with every triangle, in closed form and double precision.

    Use it for small meshes.
    """

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths z (N, H, W), metres, at pixel centres for poses (N, 4, 4).

        Triangles entirely beyond the contact band are left out. A ray that meets no other triangle has the depth inf.
        """
        depth = np.empty((len(T_sensor_object), *geometry.shape), np.float32)
        for picture, T in zip(depth, T_sensor_object, strict=True):
            triangles = mesh.triangles_m @ T[:3, :3].T + T[:3, 3]
            in_band = triangles[..., 2].min(axis=1) <= geometry.standoff_m + geometry.max_depth_m
            picture[:] = _find_first_hits(triangles[in_band], geometry).reshape(geometry.shape)
        return depth


def _find_first_hits(triangles_m: Array, geometry: SensorGeometry) -> Array:
    """Return depths (H * W,) of the nearest triangles. Each batch of RAYS rays has products that fit in the cache."""
    rays = np.stack([s.ravel() for s in np.meshgrid(*geometry.pixel_slopes)], axis=-1)
    low, high = _measure_outlines(triangles_m, geometry.is_pinhole)
    products = _multiply_edges(triangles_m, geometry.is_pinhole)
    depths = []
    for part in np.split(rays, range(RAYS, len(rays), RAYS)):
        before = ((low <= part.max(axis=0) + _ROUNDING) & (high >= part.min(axis=0) - _ROUNDING)).all(axis=1)
        depths.append(_intersect(part, [product[before] for product in products], geometry.is_pinhole))
    return np.concatenate(depths)


def _measure_outlines(triangles_m: Array, is_pinhole: bool) -> tuple[Array, Array]:
    """Return lower and upper bounds (F, 2) of the rays that can hit each triangle.

    The bounds of a triangle that reaches behind a pinhole are infinite.
    """
    seen, z = triangles_m[..., :2], triangles_m[..., 2:]
    if is_pinhole:
        with np.errstate(divide="ignore", invalid="ignore"):
            seen = seen / z
    everywhere = (z <= 0).any(axis=1) & is_pinhole
    return np.where(everywhere, -np.inf, seen.min(axis=1)), np.where(everywhere, np.inf, seen.max(axis=1))


def _multiply_edges(triangles_m: Array, is_pinhole: bool) -> list[Array]:
    """Return the terms of `_intersect` that do not depend on the rays: vectors (F, 3) and numbers (F,)."""
    a, e1, e2 = triangles_m[:, 0], triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0]
    if is_pinhole:
        back = np.cross(-a, e1)
        return [np.cross(e2, -a), back, np.cross(e2, e1), np.einsum("fk,fk->f", e2, back)]
    forward = np.array([0.0, 0.0, 1.0])
    across = [np.cross(forward, e2), np.cross(e1, forward), np.cross(e1, e2)]
    return [*across, *(np.einsum("fk,fk->f", a, w) for w in across), np.cross(e2, e1)[:, 2]]


def _intersect(rays: Array, products: list[Array], is_pinhole: bool) -> Array:
    """Return depths (K,) of rays (K, 2), by Cramer's rule with quotients of triple products (Moeller and Trumbore).

    A ray is (x/z, y/z) for a pinhole, or (x, y) for a parallel projection. `products` are from `_multiply_edges`.
    """
    x, y = rays.T
    if is_pinhole:
        d, (*across, z) = np.stack([x, y, np.ones_like(x)], -1), products
        u, v, det = (d @ w.T for w in across)
    else:
        o, across, starts, det = np.stack([x, y, np.zeros_like(x)], -1), products[:3], products[3:6], products[6]
        u, v, z = (o @ w.T - start for w, start in zip(across, starts, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, z = u / det, v / det, z / det
        inside = (u >= -_ROUNDING) & (v >= -_ROUNDING) & (u + v <= 1 + _ROUNDING) & (z > 0)
    return np.where(inside, z, np.inf).min(axis=1, initial=np.inf)


def make_box(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> TriangleMesh:
    """Return a closed box between two corners, metres."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    low, high = np.array(low_m), np.array(high_m)
    return TriangleMesh(low + corners * (high - low), _BOX_FACES.copy())


def make_cylinder(radius_m: float, z_m: tuple[float, float], sides: int = 16) -> TriangleMesh:
    """Return a closed prism about the z axis, metres. Its `sides` side faces are inside the cylinder."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    rims = [np.column_stack([ring, np.full(sides, z)]) for z in z_m]
    i, j = np.arange(sides), np.roll(np.arange(sides), -1)
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    walls = [np.column_stack([i, j, i + sides]), np.column_stack([j, j + sides, i + sides])]
    caps = [np.column_stack([low, j, i]), np.column_stack([high, i + sides, j + sides])]
    poles = np.array([[0, 0, z_m[0]], [0, 0, z_m[1]]])
    return TriangleMesh(np.concatenate([*rims, poles]), np.concatenate(walls + caps))


def move_mesh(mesh: TriangleMesh, by_m: tuple[float, float, float]) -> TriangleMesh:
    """Return the mesh shifted by a vector in metres."""
    return TriangleMesh(mesh.vertices_m + np.array(by_m), mesh.faces)


def transform_mesh(mesh: TriangleMesh, T: NDArray[np.float64]) -> TriangleMesh:
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


@lru_cache(maxsize=1)
def make_stepped_block() -> TriangleMesh:
    """Return a block of 16 x 10 x 6 mm without symmetry. Its underside (towards -z) has a boss, a ramp and a post.

    Each feature touches at a different press depth, from 0 (boss) to 1.2 mm (body).
    """
    body = make_box((-0.008, -0.005, 0.0012), (0.008, 0.005, 0.006))
    boss = make_box((-0.007, -0.004, 0.0), (-0.002, 0.001, 0.002))
    post = move_mesh(make_cylinder(0.0015, (0.0005, 0.003)), (0.004, -0.0025, 0.0))
    return join_meshes(body, boss, _make_ramp(), post)


def _make_ramp() -> TriangleMesh:
    wedge = make_box((0.001, 0.001, 0.0002), (0.007, 0.004, 0.002))
    x, y, z = wedge.vertices_m.T
    sloping = np.where(z < 0.001, z + (x - 0.001) / 6, z)
    return TriangleMesh(np.column_stack([x, y, sloping]), wedge.faces)


@lru_cache(maxsize=1)
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
    truth: NDArray[np.float64]

    def make_candidate(self, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Candidate:
        """Return the true pose moved by (x, y, yaw), metres and radians, and brought to contact, as a candidate."""
        x, y, yaw = offset
        moved = make_transform(self.truth[:3, :3] @ rotation_about([0, 0, 1], yaw), self.truth[:3, 3] + [x, y, 0.0])
        return Candidate(self.scene.bring_to_contact(moved[None])[0][0], index=0, log_p=0.0)

    def measure_error_m(self, pose: Candidate | RefinedPose) -> float:
        """Return the root mean square distance, metres, of the block's surface points from their true positions."""
        return float(PoseMetric(self.scene.object).distance(pose.T_sensor_object, self.truth))


@lru_cache(maxsize=8)
def make_block(scale: float = 1.0) -> ObjectModel:
    """Return the stepped block as an object without symmetry, scaled by a factor."""
    return make_plain_object("stepped block", scale_mesh(make_stepped_block(), scale))


def make_plain_object(name: str, mesh: TriangleMesh) -> ObjectModel:
    """Return a mesh as an object without symmetry."""
    return ObjectModel(name, mesh, SymmetryGroup.parse("none", mesh.centroid_m))


@lru_cache(maxsize=1)
def make_prism() -> ObjectModel:
    """Return a six-sided prism, 10 mm across corners and 8 mm long, with its twelve rotations `z6*x2`."""
    mesh = make_cylinder(0.005, (-0.004, 0.004), sides=6)
    return ObjectModel("prism", mesh, SymmetryGroup.parse("z6*x2", mesh.centroid_m))


@lru_cache(maxsize=1)
def make_mirrored_block() -> ObjectModel:
    """Return the mirror image of the block. No rotation maps it to the block."""
    return make_plain_object("mirrored block", mirror_mesh(make_stepped_block()))


@lru_cache(maxsize=1)
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


@lru_cache(maxsize=8)
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


def _press(scene: Scene, T_sensor_object: NDArray[np.float64], press: float) -> PressedBlock:
    scene = scene.press(press * scene.geometry.max_depth_m)
    truth = scene.bring_to_contact(T_sensor_object[None])[0][0]
    return PressedBlock(scene, make_touch(scene, truth, scene.geometry.indentation_m), truth)


def make_planar_pose(x_m: float, y_m: float, yaw_rad: float) -> NDArray[np.float64]:
    """Return the pose (4, 4), metres, at x, y and yaw, with z = 0. The features of the block face the sensor."""
    return make_transform(rotation_about([0, 0, 1], yaw_rad), [x_m, y_m, 0.0])


def make_touch(scene: Scene, T_sensor_object: NDArray[np.float64], press_depth_m: float) -> Touch:
    """Return the touch of the object at a pose (4, 4), pressed in by `press_depth_m` metres."""
    pressed = scene.press(press_depth_m)
    T = pressed.bring_to_contact(T_sensor_object[None])[0]
    shape = ContactShape(pressed.render_gel_depths(T)[0], press_depth_m)
    return Touch(shape, pressed.geometry, "pressed block", T_sensor_object=T[0])


def replace_depth(touch: Touch, depth_m: NDArray[np.float32]) -> Touch:
    """Return the touch with other depths (H, W), metres."""
    return dataclasses.replace(touch, contact_shape=ContactShape(depth_m, touch.press_depth_m))


def make_contact_poses(scene: Scene, count: int = 6) -> Poses:
    """Return clearly different contact poses (count, 4, 4), metres, which are on a circle and have different yaws."""
    angles = 2 * np.pi * np.arange(count) / count
    poses = [make_planar_pose(0.003 * np.cos(a), 0.003 * np.sin(a), 1.7 * a) for a in angles]
    return scene.bring_to_contact(np.stack(poses))[0]


def make_small_grid(count: int = 40, seed: int = 0, scene: Scene | None = None) -> PoseGrid:
    """Return a grid of `count` random contact poses of the object in a scene, by default the block's."""
    rng = np.random.default_rng(seed)
    x, y, yaw = rng.uniform(-0.004, 0.004, count), rng.uniform(-0.004, 0.004, count), rng.uniform(0, 2 * np.pi, count)
    scene = scene or make_block_scene()
    poses = scene.bring_to_contact(np.stack([make_planar_pose(*p) for p in zip(x, y, yaw, strict=True)]))[0]
    return PoseGrid(poses, PoseMetric(scene.object))


def make_training_problem(seed: int = 0) -> TrainingProblem:
    """Return a tiny problem for training an encoder before its checks, with the checks' object and camera."""
    scene = Scene(make_block(), LOPSIDED_CAMERAS["orthographic"], ReferenceRenderer())
    grid = make_small_grid(seed=seed, scene=scene)
    shapes = scene.render_grid_depths(grid.T_sensor_object)
    sampler = registry().create("grid", "face", {"spacing_mm": 4.0, "face": "-z"})
    return ListedProblem(grid, scene, sampler, lambda: iter([shapes]))


def make_place_training_problem(symmetry: str = "none") -> PlaceProblem:
    """Return a tiny training problem with an object's places, for the checks' object and camera.

    The declared `symmetry` need not be that of the object.
    """
    obj = make_block()
    obj = dataclasses.replace(obj, symmetry=SymmetryGroup.parse(symmetry, obj.mesh.centroid_m))
    scene = Scene(obj, LOPSIDED_CAMERAS["orthographic"], ReferenceRenderer())
    sampler = registry().create("grid", "whole", {"directions": 100})
    return PlaceProblem(sampler.places(obj, Progress()), scene, sampler)
