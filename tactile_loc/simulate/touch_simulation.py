"""Simulated touches: random contact poses and their contact shapes, clean or with noise."""

from __future__ import annotations

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Poses, invert
from tactile_loc.core.runtime.errors import NoContactError, TouchError
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.simulate.contact_poses import draw_contact_poses
from tactile_loc.slots.grid import GridSampler

MOST_ROUNDS = 200  # largest number of attempts to draw the missing touches


def simulate_touches(
    sampler: GridSampler,
    scene: Scene,
    count: int,
    rng: np.random.Generator,
    press_depth_m: float | None = None,
    noise: TouchNoise | None = None,
) -> list[Touch]:
    """Make `count` touches with known poses; see `draw_touches`."""
    return draw_touches(sampler, scene, count, rng, press_depth_m, noise)[0]


def draw_touches(
    sampler: GridSampler,
    scene: Scene,
    count: int,
    rng: np.random.Generator,
    press_depth_m: float | None = None,
    noise: TouchNoise | None = None,
) -> tuple[list[Touch], int]:
    """Make `count` touches with known poses, and return how many presses were refused.

    The object is pressed `press_depth_m` metres deep. If this is None, `noise` draws the press depth; without noise, it
    is the maximal depth. A pose is that of the pressed object, whose deepest point is at z = surface - press depth.

    With `noise`, the rendered pose has the sensor's calibration error. Noise is added to the contact shape, which is
    cut at the measured press depth. A press is refused if noise leaves less true contact than the sampler requires, or
    if the touch shows only a flat face. Another press is then drawn. Except for that, the same `rng` draws the same
    poses with any noise.

    Raises TouchError if the press depth is beyond the sensor's range, or if hardly any press leaves an imprint. Raises
    GridError if hardly any pose touches.
    """
    presses = PressNoise.of(scene, rng, press_depth_m, noise)
    touches: list[Touch] = []
    rounds = tried = 0
    while len(touches) < count:
        if rounds == MOST_ROUNDS:
            raise TouchError(
                f"hardly any press of {scene.object.name} by {presses.deepest_m * 1e3:.3g} mm leaves an imprint "
                "with an edge or a feature; press deeper or choose another face"
            )
        rounds += 1
        poses = draw_contact_poses(sampler, scene, count - len(touches), rng)
        tried += len(poses)
        percent = sampler.options.min_contact_percent
        for T, shape in zip(*presses.press(poses, percent), strict=True):
            touch = make_touch(shape, scene, T, f"touch-{len(touches):04d}")
            touches += [touch] if touch is not None else []
    return touches, tried - len(touches)


def press_touch(
    scene: Scene,
    T_base_sensor: Floats,
    press_depth_m: float,
    name: str = "simulated",
    noise: TouchNoise | None = None,
    rng: np.random.Generator | None = None,
) -> Touch:
    """Simulate the touch of a sensor that moves from `T_base_sensor` (4, 4), metres, along its z axis to the object.

    The object rests with its frame at the base. The touch has the true poses of sensor and object. Raises
    NoContactError if the sensor misses the object, or `noise` hides the contact, and TouchError for a press depth
    beyond the sensor's range or a flat contact.
    """
    T, touching = scene.bring_to_contact(invert(T_base_sensor)[None])
    if not touching[0]:
        raise NoContactError("the sensor misses the object; turn or move it so that its z axis meets the object")
    presses = PressNoise.of(scene, rng or np.random.default_rng(0), press_depth_m, noise)
    poses, (shape,) = presses.press(T, least_percent=0.0)
    if shape is None:
        raise NoContactError("noise hides the contact; press deeper, or choose less noise")
    return Touch(shape, scene.geometry, name, T_base_sensor=invert(poses[0]), T_sensor_object=poses[0])


class PressNoise:
    """Presses an object on a sensor that has the errors of `noise`.

    All presses are `press_depth_m` metres deep; if this is None, `noise` draws their depths. The sensor of `scene` is
    not pressed.
    """

    def __init__(self, noise: TouchNoise, scene: Scene, press_depth_m: float | None, rng: np.random.Generator) -> None:
        self.noise, self.scene, self.press_depth_m, self.rng = noise, scene, press_depth_m, rng

    @classmethod
    def of(
        cls, scene: Scene, rng: np.random.Generator, press_depth_m: float | None, noise: TouchNoise | None
    ) -> PressNoise:
        """Make the presses of simulated touches, with a random generator of their own.

        Raises TouchError if the press depth is beyond the sensor's range.
        """
        deepest = scene.geometry.max_depth_m
        if press_depth_m is not None and not 0 < press_depth_m <= deepest:
            raise TouchError(
                f"the press depth cannot be {press_depth_m * 1e3:.3g} mm on this sensor; give more than 0 and at most "
                f"{deepest * 1e3:.3g} mm"
            )
        return cls(noise or TouchNoise(), scene, press_depth_m, rng.spawn(1)[0])

    @property
    def deepest_m(self) -> float:
        """The depth of the deepest press, metres."""
        return self.scene.geometry.max_depth_m if self.press_depth_m is None else self.press_depth_m

    def press(self, T_sensor_object: Poses, least_percent: float) -> tuple[Poses, list[ContactShape | None]]:
        """Press an object at poses (N, 4, 4), metres, where it just touches. Return the pressed poses and their shapes.

        A contact shape is None if noise leaves less than `least_percent` of the observed pixels in true contact.
        """
        noise, geometry = self.noise, self.scene.geometry
        seen, touching = self._misplace(T_sensor_object)
        press = self._draw_presses(len(seen))
        clean = self._render_depths(lower(seen, press), press)
        noisy = noise.corrupt(clean, press, geometry, self.rng)
        measured = noise.measure_press(press, geometry.max_depth_m, self.rng)
        depths = noise.cut(noisy, press, measured)
        shapes = [ContactShape(depth, float(m)) for depth, m in zip(depths, measured, strict=True)]
        poses = lower(T_sensor_object, press)
        if noise == TouchNoise():
            return poses, list(shapes)
        least = max(1.0, least_percent / 100 * geometry.observed_mask.sum())
        # spurious contact does not count
        real = (clean < press.astype(np.float32)[:, None, None]) & geometry.observed_mask
        kept = touching & [np.count_nonzero(s.contact & r) >= least for s, r in zip(shapes, real, strict=True)]
        return poses, [shape if ok else None for shape, ok in zip(shapes, kept, strict=True)]

    def _render_depths(self, T_sensor_object: Poses, press_m: Floats) -> Float32:
        """Render contact depths (N, H, W), metres, at the maximal depth, of poses pressed by `press_m` (N,)."""
        depths = np.empty((len(press_m), *self.scene.geometry.shape), np.float32)
        for m in np.unique(press_m):
            these, scene = press_m == m, self.scene.press(m, self.scene.geometry.max_depth_m)
            depths[these] = scene.render_gel_depths(T_sensor_object[these])
        return depths

    def _misplace(self, T_sensor_object: Poses) -> tuple[Poses, Bools]:
        """Return the real poses (N, 4, 4), metres, brought to contact, and which of them touch (N,)."""
        if not self.noise.misplaces:
            return T_sensor_object, np.ones(len(T_sensor_object), bool)
        return self.scene.bring_to_contact(self.noise.misplace(T_sensor_object, self.scene.geometry, self.rng))

    def _draw_presses(self, count: int) -> Floats:
        """Return the depths (count,) of presses, metres."""
        if self.press_depth_m is not None:
            return np.full(count, self.press_depth_m)
        return self.noise.draw_press(count, self.scene.geometry.max_depth_m, self.rng)


def lower(T_sensor_object: Poses, press_m: Floats) -> Poses:
    """Return poses (N, 4, 4) that are `press_m` (N,) metres deeper in the sensor."""
    T = T_sensor_object.copy()
    T[:, 2, 3] -= press_m
    return T


def make_touch(shape: ContactShape | None, scene: Scene, T: Floats, name: str) -> Touch | None:
    """Make one touch. Return None if there is no contact, or if a flat face covers the sensor."""
    try:
        return None if shape is None else Touch(shape, scene.geometry, name, T_sensor_object=T)
    except TouchError:
        return None
