"""Public sets of real touches with known poses of the gel: TactileTracking, and Real Tactile MNIST.

Both state where the gel was while the object was at rest, but not where the object was. Huang et al., NormalFlow, RA-L
2024, and Schneider et al., The Tactile MNIST Benchmark, describe them. A gel's frame has its origin on the gel, and z
points out of the gel.
"""

from pathlib import Path
from typing import Any

import av
import numpy as np
from datasets import Dataset, Features, Image
from scipy.spatial.transform import Rotation
from tactile_loc import SensorTrack
from tactile_loc.plugin import ConfigError, Poses, TouchError
from tactile_loc.plugin.helpers import make_transform

from tactile_loc_datasets.episodes import USUAL_HZ, Episode

VIDEO, TRIAL = "gelsight.avi", "true_start_T_currs.npy"  # of a trial of TactileTracking
IMAGES, POSES = "sensor_image", "gel_pose_cell_frame"  # columns of Real Tactile MNIST, one row for each round


def read_trial(path: Path) -> Episode:
    """Read a trial of TactileTracking. The base frame is the gel's frame in the first image.

    Raises ConfigError if the poses or the video cannot be read.
    """
    try:
        T_start_gel = np.load(path / TRIAL, allow_pickle=False)
        with av.open(str(path / VIDEO)) as film:
            rate_hz = float(film.streams.video[0].average_rate or USUAL_HZ)
    except (OSError, ValueError, av.FFmpegError) as error:
        raise ConfigError(f"{path} cannot be read as a trial of TactileTracking ({error}); copy it again") from error
    if T_start_gel.shape[1:] != (4, 4) or not len(T_start_gel):
        raise ConfigError(f"{path / TRIAL} has the shape {T_start_gel.shape} instead of (N, 4, 4); copy it again")
    times_s = np.arange(len(T_start_gel)) / rate_hz
    table = Dataset.from_dict({"frame_index": np.arange(len(times_s)), "timestamp": times_s})
    return Episode(str(path), VIDEO, table, times_s, path / VIDEO, T_base_gel=np.asarray(T_start_gel, float))


def read_round(path: Path, rows: Dataset, number: int) -> Episode:
    """Return the touches of a round of Real Tactile MNIST. The base frame is that of the round's cell.

    Raises ConfigError if there is no such round, and TouchError if the images and the poses differ in number.
    """
    if not 0 <= number < len(rows):
        raise ConfigError(f"{path} has no round {number}; it has {len(rows)}, from 0 on")
    row: dict[str, Any] = rows[number]
    position_m, quaternion = (np.array(row[POSES][key], float) for key in ("position", "quaternion"))
    if not len(row[IMAGES]) == len(position_m) == len(quaternion):
        raise TouchError(f"round {number} of {path} has {len(row[IMAGES])} images but {len(position_m)} poses")
    T = np.tile(np.eye(4), (len(position_m), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_quat(quaternion).as_matrix(), position_m
    table = Dataset.from_dict({IMAGES: row[IMAGES]}, Features({IMAGES: Image()}))
    for name, value in (("round", number), ("object_id", row["object_id"])):
        table = table.add_column(name, [value] * len(T))
    return Episode(f"round {number} of {path}", IMAGES, table, np.arange(len(T), dtype=float), T_base_gel=T)


def place_sensor(episode: Episode, standoff_m: float, turn_deg: float) -> SensorTrack:
    """Return the poses of the sensor from those of the gel, whose images are turned about its normal."""
    T_gel_sensor = make_transform(Rotation.from_euler("z", turn_deg, degrees=True).as_matrix(), [0, 0, -standoff_m])
    T_base_sensor: Poses = episode.T_base_gel @ T_gel_sensor
    return SensorTrack(Path(episode.name), (), episode.times_s, T_base_sensor)
