"""A prior's file, in mm and degrees, becomes the prior that it describes."""

from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform, make_translation, rotation_about
from tactile_loc.core.poses.priors import GaussianPrior, HypothesesPrior, RegionPrior
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.io.prior_files import read_prior

GAUSSIAN = 'kind = "gaussian"\nframe = "sensor"\ntranslation_std_mm = 4\n'
HYPOTHESES = (
    'kind = "hypotheses"\nframe = "sensor"\nposes = "poses.npz"\ntranslation_std_mm = 4\nrotation_std_deg = 5\n'
)
REGION = 'kind = "region"\nframe = "sensor"\n'
HALF_SPACE = 'kind = "half-space"\nframe = "sensor"\nnormal = [0, 0, 1]\nplane_point_mm = [0, 0, 20]\n'
POSE = "xyz_mm = [1, 2, 25]\nrpy_deg = [0, 0, 90]\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "prior.toml"
    path.write_text(text)
    return path


def random_poses(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return make_transform(draw_rotations(count, rng), rng.normal(scale=0.02, size=(count, 3)))


@pytest.mark.parametrize("pose", [POSE, "T = [[0, -1, 0, 0.001], [1, 0, 0, 0.002], [0, 0, 1, 0.025], [0, 0, 0, 1]]\n"])
def test_a_gaussian_prior_is_given_in_mm_and_degrees_or_as_a_matrix_in_metres(tmp_path, box, pose):
    prior = read_prior(written(tmp_path, GAUSSIAN + pose + "rotation_std_deg = 10\n"), box).prior
    T = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.001, 0.002, 0.025])
    expected = GaussianPrior(T, 0.004, np.radians(10))(random_poses(20))
    np.testing.assert_allclose(prior(random_poses(20)), expected, rtol=1e-9)


def test_an_omitted_rotation_is_unknown(tmp_path, box):
    prior = read_prior(written(tmp_path, GAUSSIAN + POSE), box).prior
    turned = make_transform(draw_rotations(9, np.random.default_rng(0)), [0.001, 0.002, 0.025])
    np.testing.assert_allclose(prior(turned), 0, atol=1e-12)


def test_a_prior_respects_the_symmetry_of_the_object(tmp_path, make_box):
    brick = make_box(0.03, 0.02, 0.01, symmetry="z2")
    prior = read_prior(written(tmp_path, GAUSSIAN + POSE + "rotation_std_deg = 10\n"), brick).prior
    poses = random_poses(20)
    np.testing.assert_allclose(prior(poses @ brick.symmetry.list_elements()[1]), prior(poses), atol=1e-9)


def test_a_list_of_poses_is_seen_from_the_camera(tmp_path, box):
    T, T_base_camera = random_poses(2), make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.001, 0.002, 0.025])
    np.savez(tmp_path / "poses.npz", poses=T, scores=np.array([3.0, 1.0]))
    prior = read_prior(written(tmp_path, HYPOTHESES + POSE), box).prior
    expected = tuple(GaussianPrior(T_base_camera @ one, 0.004, np.radians(5)) for one in T)
    poses = T_base_camera @ random_poses(9)
    np.testing.assert_allclose(prior(poses), HypothesesPrior(expected, np.array([0.75, 0.25]))(poses), rtol=1e-6)
    in_sensor = read_prior(written(tmp_path, HYPOTHESES + 'scores = "equal"\n'), box).prior
    np.testing.assert_allclose(in_sensor.list_peaks(), T, atol=1e-12)
    np.testing.assert_allclose(in_sensor.probabilities, 0.5)


@pytest.mark.parametrize("name", ["poses.npz", "bop.csv", "detections.json"])
def test_a_list_in_place_of_a_prior_is_refused_with_the_key_that_names_it(tmp_path, box, name):
    with pytest.raises(ConfigError, match=naming(name, f'poses = "{name}"')):
        read_prior(tmp_path / name, box)


def test_a_region_may_be_open_and_bounds_the_centroid(tmp_path, box):
    text = REGION + "low_mm = [-inf, 0, -5]\nhigh_mm = [3, inf, 5]\n"
    poses = random_poses(200)
    expected = RegionPrior([-np.inf, 0, -0.005], [0.003, np.inf, 0.005], box.mesh.centroid_m)(poses)
    assert 0 < np.isfinite(expected).sum() < 200
    assert np.array_equal(read_prior(written(tmp_path, text), box).prior(poses), expected)


def test_a_half_space_may_bound_another_point_of_the_object(tmp_path, box):
    poses = make_translation([[0, 0, 0.013], [0, 0, 0.009]])
    prior = read_prior(written(tmp_path, HALF_SPACE + "object_point_mm = [0, 0, 9]\n"), box).prior
    assert prior(poses).tolist() == [0.0, -np.inf]
    assert read_prior(written(tmp_path, HALF_SPACE), box).prior(poses).tolist() == [-np.inf, -np.inf]


def test_a_prior_in_the_base_frame_needs_the_sensors_pose_and_one_in_the_sensors_frame_does_not(tmp_path, box):
    own = read_prior(written(tmp_path, GAUSSIAN + POSE), box)
    assert own.view_from(None) is own.view_from(random_poses(1)[0]) is own.prior
    framed = read_prior(written(tmp_path, (GAUSSIAN + POSE).replace('"sensor"', '"base"')), box)
    T_base_sensor, T_base_object = random_poses(2, seed=3)
    T_base_object[:3, 3] = [0.001, 0.002, 0.025]
    seen = framed.view_from(T_base_sensor)((invert(T_base_sensor) @ T_base_object)[None])
    np.testing.assert_allclose(seen, 0, atol=1e-9)
    with pytest.raises(ConfigError, match=naming("prior.toml", "T_base_sensor")):
        framed.view_from(None)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("", ("kind", "gaussian", "region", "half-space")),
        ('kind = "gausian"\n', ("'gausian'", "'gaussian'")),
        ("kind = [1]\n", ("kind", "[1]", "gaussian")),
        (GAUSSIAN, ("T", "xyz_mm", "rpy_deg", "quaternion_wxyz")),
        (GAUSSIAN + POSE + "rotation_std = 3\n", ("'gaussian'", "'rotation_std'", "'rotation_std_deg'")),
        (GAUSSIAN + POSE + "rotation_std_deg = 0\n", ("rotation_std_deg", 0)),
        (GAUSSIAN.replace("4", "inf") + POSE, ("translation_std_mm", "inf")),
        (GAUSSIAN.replace('"sensor"', '"camera"') + POSE, ("frame", "'camera'", "'sensor'", "'base'")),
        ('kind = "gaussian"\ntranslation_std_mm = 4\n', ("frame", "'sensor'", "'base'")),
        (HYPOTHESES, ("poses.npz",)),
        (HYPOTHESES + 'scores = "best"\n', ("scores", "'proportional'", "'log'", "'equal'")),
        (HYPOTHESES + "score = 1\n", ("'score'", "'scores'")),
        (REGION + "low_mm = [0, 0]\n", ("low_mm", "[0, 0]")),
        (REGION + "low_mm = [0, 0, 0]\nhigh_mm = [1, 0, 1]\n", ("low_mm", "high_mm", "[1.0, 0.0, 1.0]")),
        (HALF_SPACE.replace("[0, 0, 1]", "[0, 0, 0]"), ("[0. 0. 0.]",)),
        ("kind = ", ("TOML",)),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence(tmp_path, box, text, values):
    path = written(tmp_path, text)
    with pytest.raises(ConfigError, match=naming(path, *values)) as caught:
        read_prior(path, box)
    assert "\n" not in str(caught.value).split("TOML")[0]
    with pytest.raises(ConfigError, match=naming(tmp_path / "none.toml")):
        read_prior(tmp_path / "none.toml", box)
