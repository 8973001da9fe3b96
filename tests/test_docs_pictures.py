"""The pictures of the guide: tracking errors up to symmetry, and the noise levels in one colour scale."""

import matplotlib.pyplot as plt
import numpy as np
import pictures as guide
import pytest

from tactile_loc.core.geometry.lie import move
from tactile_loc.core.geometry.rigid import draw_rotations, make_transform, rotation_about
from tactile_loc.core.sensing.noise import NOISE
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


def test_errors_are_the_centroid_shift_and_the_rotation_angle(box, truth):
    found = [tracked(k, move(T, np.array([3e-4, 0, 4e-4, 0, 0.01, 0]))) for k, T in enumerate(truth)]
    errors = guide.measure_track(found, truth, box)  # the box's centroid is its frame's origin
    assert np.allclose(errors.shift_m, 5e-4)
    assert np.allclose(errors.turn_rad, 0.01)
    assert np.allclose(errors.shift_std_m, np.sqrt(3) * 1e-4)
    assert np.allclose(errors.turn_std_rad, np.sqrt(3) * 1e-3)


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


def test_every_noise_level_has_the_same_colour_scale(localizer):
    figure = guide.draw_noise(localizer)
    texts = [text.get_text() for text in figure.findobj(plt.Text)]
    titles = [text for text in texts if text.split(",")[0] in NOISE]
    assert [title.split(",")[0] for title in titles] == [level for level in NOISE for _ in range(5)]
    assert titles[0] == "none, 2.0 mm"
    scales = [axes.images[0].get_clim() for axes in figure.axes if axes.images]
    assert np.array(scales) == pytest.approx(np.tile([0.0, 2.0], (15, 1)))
