"""Registration of many poses, each to all touches at once, by robust Gauss-Newton steps.

Lengths are in mm. A twist (6,) is a rotation vector (rad), then a translation (mm). A touch's twist is about the
touch's centre, in the frame of its sensor. The object's twist is about the object's centre, in the frame of the first
sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.geometry.twists import adjoint, exponential, logarithm
from tactile_loc.core.objects.blocks import Blocks, NearestTriangles
from tactile_loc.core.registration.observations import Observed
from tactile_loc.core.runtime.turns import split_into_turns

SETTLED_MM = 1e-3  # a pose has converged if its last step was shorter
A_TURN = 600  # steps of single poses with single touches in one turn; a step with all points counts as `stride` steps
Floats = NDArray[np.float64]
NO_PEAKS, NO_PULLS = np.empty((0, 4, 4)), np.empty((0, 6, 6))


class Registered(NamedTuple):
    """The registered poses of an object.

    `T` (K, 4, 4) are its poses in the first sensor's frame. `T_each` (K, N, 4, 4) are its poses in the frame of each
    touch's sensor, as this touch shows them. `T_reported` (K, 4, 4) are its poses relative to the reported pose of the
    first sensor, which has an error. `moved` (K,) is the length of the last step, mm. The other arrays are from before
    this step: `misfit` (K,), mm^2, states how badly the poses explain the touches, and `parts` (K, 2, 6, 6) are the
    information about twists from the first touch and from all others.
    """

    T: Floats
    T_each: Floats
    T_reported: Floats
    moved: Floats
    misfit: Floats
    parts: Floats


@dataclass(frozen=True, eq=False)
class Registration:
    """A registration problem: `observed`, the observations of N touches, and the touched object.

    The object has `triangles`, `samples` of its surface and a centre `middle` (3,). `T_sensor_first` (N, 4, 4) converts
    from the first sensor's frame to each sensor's frame. The touch of the first sensor itself can be left out. Each of
    these transforms has an unknown error, a twist about the touch's centre. The variances of this twist are the sum of
    `sensor` (N, 6), from the sensor's pose, and `press` (N, 6), from the press depth. `noise` is the least standard
    deviation of a point. The weights in `observed` assume this noise.
    """

    observed: Observed
    T_sensor_first: Floats
    sensor: Floats
    press: Floats
    noise: float
    triangles: NearestTriangles
    samples: Blocks
    middle: Floats

    def register(
        self, T: Floats, scales: Floats, finely: int, stride: int, peaks: Floats = NO_PEAKS, pulls: Floats = NO_PULLS
    ) -> Registered:
        """Move poses T (K, 4, 4), in the first sensor's frame, so that they explain all touches.

        `scales` (I,) are the scales of the robust weights, one for each step. The last `finely` steps use all points.
        The other steps use one point out of `stride`. A prior pulls the poses to its `peaks` (K, 4, 4) with the
        information `pulls` (K, 6, 6) about twists of the object from a peak.
        """
        from tactile_loc.core.registration.steps import register_poses
        from tactile_loc.core.runtime.compiled import run_in_threads  # numba takes a while to import

        T, count = np.array(T), len(T)
        T_each = self.T_sensor_first @ T[:, None]
        parts, moved, misfit = np.zeros((count, 2, 6, 6)), np.full(count, np.inf), np.full(count, np.inf)
        steps = len(scales) + finely * (stride - 1)
        for some in split_into_turns(count, A_TURN / (steps * len(self.T_sensor_first))):
            run_in_threads(
                register_poses, len(T[some]), T[some], T_each[some], parts[some], moved[some], misfit[some],
                self.observed, self.triangles, self.samples, self.middle, self.T_sensor_first,
                self.sensor + self.press, self.noise, scales, finely, stride, SETTLED_MM,
                peaks[some], pulls[some],
            )  # fmt: skip
        return Registered(self._view_from_first(T, T_each[:, 0]), T_each, T, moved, misfit, parts)

    def inform(self, T: Floats, parts: Floats) -> Floats:
        """Return the information (K, 6, 6) about twists of `Registered.T`.

        T (K, 4, 4) are the poses `Registered.T_reported`, and `parts` (K, 2, 6, 6) their information.
        """
        return self._marginalise_first(parts, T, self.press[0], self.sensor[0])

    def inform_reported(self, T: Floats, parts: Floats) -> Floats:
        """Return the information (K, 6, 6) about twists of `Registered.T_reported`, given what `inform` is given."""
        return self._marginalise_first(parts, T, self.press[0] + self.sensor[0], np.zeros(6))

    def _marginalise_first(self, parts: Floats, T: Floats, own: Floats, others: Floats) -> Floats:
        """Return the information (K, 6, 6) about a twist of the object, along the axes of the first sensor.

        `parts` (K, 2, 6, 6) is the information from the first touch and from all other touches. They are reduced by
        errors with the variances `own` (6,) and `others` (6,), which are twists about the first touch's centre.

        The object's pose in the first sensor's frame is seen by the first touch with the error of its press depth, and
        by the others with the error of the first sensor's pose. The object's pose relative to the reported pose of the
        first sensor is seen by the first touch with both errors, and by the others with none of them.
        """
        back = invert(self.T_sensor_first[0])
        touched = back[:3, :3] @ self.observed.centres[0] + back[:3, 3]
        to_centre = adjoint(back[:3, :3], T[:, :3, :3] @ self.middle + T[:, :3, 3] - touched)[:, None]
        allowed = np.stack([own, others])[:, None, :] * to_centre @ to_centre.swapaxes(-1, -2)
        total = np.linalg.solve(np.eye(6) + parts @ allowed, parts).sum(axis=1)
        return np.asarray((total + total.swapaxes(1, 2)) / 2)

    def _view_from_first(self, T: Floats, seen: Floats) -> Floats:
        """Correct poses T (K, 4, 4) by the error of the first sensor's pose, but not by the error of its press depth.

        T is relative to the reported pose of the first sensor. `seen` (K, 4, 4) are the poses that the first touch
        shows, in the frame of its sensor. The difference is the sum of both errors, and is divided between them in
        proportion to their variances. If the touch of the first sensor is left out, the first other touch counts.
        """
        if not self.sensor[0].any():
            return T
        allowed = self.sensor[0] + self.press[0]
        share = np.divide(self.sensor[0], allowed, out=np.zeros(6), where=allowed > 0)
        centre, here = self.observed.centres[0], self.T_sensor_first[0]
        reported = here @ T
        corrected = exponential(share * logarithm(seen @ invert(reported), centre), centre) @ reported
        return np.asarray(invert(here) @ corrected)
