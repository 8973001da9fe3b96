"""TactileTracking and Real Tactile MNIST, on small replicas: images, poses of the sensor, and what is refused."""

from pathlib import Path

import datasets
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tactile_loc import TactileLocError

from tactile_loc_datasets.known_motions import IMAGES, POSES, TRIAL, VIDEO, place_sensor
from tactile_loc_datasets.readers import read_episode

HZ, ROWS = 10, 6  # of the videos
STANDOFF_M, TURN_DEG = 0.012, 90.0
PLACES_M = np.linspace([0.01, -0.02, 0.005], [0.02, 0.0, 0.006], ROWS)
TURNS = Rotation.from_euler("xyz", np.linspace([0, np.pi, 0], [0.2, np.pi, 0.9], ROWS))


def make_gel_poses() -> np.ndarray:
    T = np.tile(np.eye(4), (ROWS, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = TURNS.as_matrix(), PLACES_M
    return T


@pytest.fixture
def trial(film, tmp_path: Path) -> Path:
    np.save(tmp_path / TRIAL, make_gel_poses())
    film.rename(tmp_path / VIDEO)
    return tmp_path


@pytest.fixture
def rounds(images, tmp_path: Path) -> Path:
    """Two rounds, as the set's documentation describes their columns."""
    poses = {"position": PLACES_M.tolist(), "quaternion": TURNS.as_quat().tolist()}
    features = datasets.Features(
        {
            "object_id": datasets.Value("int64"),
            POSES: {name: datasets.List(datasets.List(datasets.Value("float64"))) for name in poses},
            IMAGES: datasets.List(datasets.Image()),
        }
    )
    rows = {"object_id": [7, 8], POSES: [poses, poses], IMAGES: [list(of_round) for of_round in images]}
    datasets.Dataset.from_dict(rows, features).to_parquet(tmp_path / "train.parquet")
    return tmp_path


def test_a_trial_has_the_frames_and_the_poses_of_the_gel(trial, images):
    episode = read_episode(trial)
    levels = [frame.image.mean() for frame in episode.read_frames()]
    assert levels == pytest.approx(images[0].mean(axis=(1, 2, 3)), abs=4)
    np.testing.assert_allclose(episode.times_s, np.arange(ROWS) / HZ)
    np.testing.assert_allclose(episode.T_base_gel, make_gel_poses())


def test_a_round_has_the_images_and_the_poses_of_its_touches(rounds, images):
    episode = read_episode(rounds, 1)
    np.testing.assert_array_equal([frame.image for frame in episode.read_frames()], images[1])
    np.testing.assert_allclose(episode.T_base_gel, make_gel_poses(), atol=1e-12)
    assert episode.table["object_id"][:] == [8] * ROWS


def test_the_sensor_looks_at_the_gel_from_its_standoff(trial):
    episode = read_episode(trial)
    track = place_sensor(episode, STANDOFF_M, TURN_DEG)
    for number, time_s in enumerate(episode.times_s):
        T = track.look_up(f"row-{number:06d}", time_s)
        np.testing.assert_allclose(T @ [0, 0, STANDOFF_M, 1], [*PLACES_M[number], 1], atol=1e-9)  # the gel's centre
        x_gel = make_gel_poses()[number, :3, :3].T @ T[:3, 0]
        np.testing.assert_allclose(x_gel, [0, 1, 0], atol=1e-9)  # turned by a quarter about z


def test_damaged_sets_are_refused(trial, rounds):
    np.save(trial / TRIAL, np.eye(4))
    with pytest.raises(TactileLocError, match="shape"):
        read_episode(trial)
    (trial / VIDEO).write_bytes(b"no video")
    with pytest.raises(TactileLocError, match="cannot be read"):
        read_episode(trial)
    (trial / TRIAL).unlink()
    with pytest.raises(TactileLocError, match="no round 2"):
        read_episode(rounds, 2)
