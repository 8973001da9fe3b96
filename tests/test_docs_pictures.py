"""The pictures of the guide: tracking errors up to symmetry, and the noise levels in one colour scale."""

import numpy as np
import pictures as guide
import pytest

from tactile_loc.core.geometry.rigid import draw_rotations, make_transform, rotation_about
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.tracking.tracker import TrackedPose

COUNT = 12
GEL = np.array([0.0, 0.0, 0.01])


def tracked(k: int, T: np.ndarray | None, verdict: Verdict = Verdict.CERTAIN) -> TrackedPose:
    C = None if T is None else np.diag([1e-8] * 3 + [1e-6] * 3)
    poses = np.empty((0, 4, 4)) if T is None else T[None]
    return TrackedPose(verdict, poses, np.ones(len(poses)), C, 0.9, time_s=0.1 * k)


@pytest.fixture(scope="module")
def truth():
    rng = np.random.default_rng(0)
    return make_transform(draw_rotations(COUNT, rng), 0.01 * rng.normal(size=(COUNT, 3)))


def test_the_track_picture_uses_symmetry_and_shades_uncertain_poses(make_box, truth):
    obj = make_box(0.03, 0.02, 0.012, symmetry="z2")
    half_turn = make_transform(rotation_about([0, 0, 1], np.pi), np.zeros(3))
    doubtful = [Verdict.NO_CONTACT, Verdict.AMBIGUOUS, Verdict.POOR_FIT, Verdict.NOT_FOUND]
    verdicts = [*doubtful, *[Verdict.CERTAIN] * (COUNT - 4)]
    found = [
        tracked(k, None if k == 0 else T @ half_turn, verdict)
        for k, (T, verdict) in enumerate(zip(truth, verdicts, strict=True))
    ]
    figure = guide.draw_track(found, truth, obj, GEL, "a box")
    path, above, below = (axes for sub in figure.subfigs for axes in sub.axes)
    for axes in (above, below):
        (error,) = [line for line in axes.get_lines() if line.get_label() == "error"]
        assert len(error.get_ydata()) == COUNT - 1
        assert np.abs(error.get_ydata()).max() < 1e-4
        assert len(axes.patches) == 4
    assert len(path.get_lines()) == 2
