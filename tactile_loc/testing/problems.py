"""Ready scenes and touches: small cameras, a block whose every feature differs, and candidates near the truth."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry import make_transform, rotation_about
from tactile_loc.core.interfaces import Candidate, RefinedPose, Scene, TrainingProblem
from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.poses import PoseGrid, PoseMetric, Poses
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import ContactShape, SensorGeometry, Touch
from tactile_loc.core.symmetry import SymmetryGroup
from tactile_loc.testing.shapes import ReferenceRenderer, scaled, stepped_block

# The first two are square and centred, so that a quarter turn maps the image to itself; the others have nothing
# symmetric about them. All see about 25 mm of the surface and resolve a press of 2 mm.
CAMERAS = {
    "orthographic": SensorGeometry("orthographic", 64, 64, 2500.0, 2500.0, 32.0, 32.0, 0.010, 0.002),
    "pinhole": SensorGeometry("pinhole", 64, 64, 62.5, 62.5, 32.0, 32.0, 0.025, 0.002),
}
LOPSIDED_CAMERAS = {
    "orthographic": SensorGeometry("orthographic", 80, 56, 3100.0, 2400.0, 37.3, 30.1, 0.021, 0.002),
    "pinhole": SensorGeometry("pinhole", 80, 56, 65.0, 50.0, 37.3, 30.1, 0.021, 0.002),
}

POSE = (0.0012, -0.0009, np.radians(25.0))  # x, y in metres and yaw: where the block is pressed
OFFSETS = ((0.0008, -0.0006, 0.0), (-0.0007, 0.0, np.radians(4.0)), (0.0, 0.0009, np.radians(-5.0)))


@dataclass(frozen=True, eq=False)
class PressedBlock:
    """A touch, the scene it was made in, and the true T_sensor_object (4, 4), metres."""

    scene: Scene
    touch: Touch
    truth: NDArray[np.float64]

    def candidate(self, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Candidate:
        """Return the truth moved by (x, y, yaw), metres and radians, and brought to contact."""
        x, y, yaw = offset
        turned = make_transform(self.truth[:3, :3] @ rotation_about([0, 0, 1], yaw), self.truth[:3, 3] + [x, y, 0.0])
        return Candidate(self.scene.in_contact(turned[None])[0][0], index=0, log_p=0.0)

    def error_m(self, pose: Candidate | RefinedPose) -> float:
        """Return the root mean square distance of the block's surface from where it is, metres."""
        return float(PoseMetric(self.scene.object).distance(pose.T_sensor_object, self.truth))


@lru_cache(maxsize=8)
def block(scale: float = 1.0) -> ObjectModel:
    """Return the stepped block as an object without symmetry, made larger by a factor."""
    mesh = scaled(stepped_block(), scale)
    return ObjectModel("stepped block", mesh, SymmetryGroup.parse("none", mesh.centroid_m))


def larger(geometry: SensorGeometry, scale: float) -> SensorGeometry:
    """Return the sensor with all its lengths multiplied by a factor; the image stays as large in pixels."""
    k = 1.0 if geometry.is_pinhole else scale
    return dataclasses.replace(
        geometry, fx=geometry.fx / k, fy=geometry.fy / k,
        standoff_m=geometry.standoff_m * scale, max_depth_m=geometry.max_depth_m * scale,
    )  # fmt: skip


@lru_cache(maxsize=8)
def block_scene(camera: str = "orthographic", scale: float = 1.0) -> Scene:
    """Return the block before one of the CAMERAS, all lengths times `scale`, drawn by the reference renderer."""
    return Scene(block(scale), larger(CAMERAS[camera], scale), ReferenceRenderer())


def pressed_block(camera: str = "orthographic", scale: float = 1.0, press: float = 1.0) -> PressedBlock:
    """Return the block pressed at POSE; `press` is the share (0 to 1) of the deepest press."""
    x, y, yaw = POSE
    scene = block_scene(camera, scale)
    truth = scene.in_contact(planar_pose(x * scale, y * scale, yaw)[None])[0][0]
    return PressedBlock(scene, touch_at(scene, truth, press * scene.geometry.max_depth_m), truth)


def planar_pose(x_m: float, y_m: float, yaw_rad: float) -> NDArray[np.float64]:
    """Return a pose (4, 4) with the features towards the sensor: x, y in metres, yaw in radians; z is zero."""
    return make_transform(rotation_about([0, 0, 1], yaw_rad), [x_m, y_m, 0.0])


def touch_at(scene: Scene, T_sensor_object: NDArray[np.float64], press_depth_m: float) -> Touch:
    """Return the touch that the object at a pose (4, 4), brought to contact, makes at a press in metres."""
    T = scene.in_contact(T_sensor_object[None])[0]
    shape = ContactShape(scene.contact_depths(T, press_depth_m)[0], press_depth_m)
    return Touch(shape, scene.geometry, "pressed block", T_sensor_object=T[0])


def with_depth(touch: Touch, depth_m: NDArray[np.float32]) -> Touch:
    """Return the touch with other depths (H, W), metres."""
    return dataclasses.replace(touch, contact_shape=ContactShape(depth_m, touch.press_depth_m))


def contact_poses(scene: Scene, count: int = 6) -> Poses:
    """Return `count` clearly different contact poses (count, 4, 4), metres: a circle of places and yaws."""
    turn = 2 * np.pi * np.arange(count) / count
    poses = [planar_pose(0.003 * np.cos(a), 0.003 * np.sin(a), 1.7 * a) for a in turn]
    return scene.in_contact(np.stack(poses))[0]


def small_grid(count: int = 40, seed: int = 0, scene: Scene | None = None) -> PoseGrid:
    """Return a grid of `count` different contact poses of the block in a scene, in no order."""
    rng = np.random.default_rng(seed)
    x, y, yaw = rng.uniform(-0.004, 0.004, count), rng.uniform(-0.004, 0.004, count), rng.uniform(0, 2 * np.pi, count)
    scene = scene or block_scene()
    poses = scene.in_contact(np.stack([planar_pose(*p) for p in zip(x, y, yaw, strict=True)]))[0]
    return PoseGrid(poses, PoseMetric(scene.object))


def training_problem(seed: int = 0) -> TrainingProblem:
    """Return a tiny problem for an encoder to be trained on before it is checked: the checks' object and camera."""
    scene = Scene(block(), LOPSIDED_CAMERAS["orthographic"], ReferenceRenderer())
    grid = small_grid(seed=seed, scene=scene)
    shapes = scene.grid_depths(grid.T_sensor_object)
    sampler = registry().create("grid", "face", {"spacing_mm": 4.0, "face": "-z"})
    return TrainingProblem(grid, scene, sampler, lambda: iter([shapes]))
