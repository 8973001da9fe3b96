"""Data sets with twelve images, written by the libraries that robots' data sets come from."""

import json
from collections.abc import Sequence
from pathlib import Path

import av
import datasets
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

COLUMN, HZ, ROWS = "observation.images.gel", 10, 6
FEATURES = {name: {"dtype": "int64", "shape": [1]} for name in ("frame_index", "episode_index", "index")}


def make_images(episode: int) -> np.ndarray:
    """Six images (6, 96, 128, 3), each of its own grey."""
    levels = 20 * np.arange(ROWS) + 100 * episode + 10
    return np.broadcast_to(levels[:, None, None, None], (ROWS, 96, 128, 3)).astype(np.uint8)


def write_video(path: Path, images: Sequence[np.ndarray]) -> None:
    """Write images as LeRobot does: AV1, with a key frame every second frame."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as film:
        stream = film.add_stream("libsvtav1", rate=HZ, width=128, height=96, pix_fmt="yuv420p")
        stream.options = {"g": "2", "crf": "30"}
        for image in images:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")))
        film.mux(stream.encode())


def make_rows(episode: int) -> dict[str, list]:
    numbers = list(range(ROWS))
    return {
        "timestamp": [n / HZ for n in numbers],
        "frame_index": numbers,
        "episode_index": [episode] * ROWS,
        "index": [ROWS * episode + n for n in numbers],
    }


def write(path: Path, rows: dict[str, list]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pyarrow.table(rows), path)


def write_info(folder: Path, version: str, **paths: str) -> Path:
    features = {**FEATURES, COLUMN: {"dtype": "video", "shape": [96, 128, 3]}}
    info = {"codebase_version": version, "fps": HZ, "total_episodes": 2, "chunks_size": 1000, "features": features}
    (folder / "meta").mkdir(exist_ok=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info | paths))
    return folder


@pytest.fixture
def version_2(tmp_path: Path) -> Path:
    """A LeRobot data set of version 2.1: a table and a video for each episode."""
    for episode in range(2):
        write(tmp_path / f"data/chunk-000/episode_{episode:06d}.parquet", make_rows(episode))
        write_video(tmp_path / f"videos/chunk-000/{COLUMN}/episode_{episode:06d}.mp4", make_images(episode))
    return write_info(
        tmp_path,
        "v2.1",
        data_path="data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        video_path="videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    )


@pytest.fixture
def version_3(tmp_path: Path) -> Path:
    """A LeRobot data set of version 3.0: one table and one video for both episodes."""
    first, second = make_rows(0), make_rows(1)
    write(tmp_path / "data/chunk-000/file-000.parquet", {key: first[key] + second[key] for key in first})
    write_video(tmp_path / f"videos/{COLUMN}/chunk-000/file-000.mp4", [*make_images(0), *make_images(1)])
    zeros = [0, 0]
    places = {
        f"{start}/{end}": zeros for start in ("data", f"videos/{COLUMN}") for end in ("chunk_index", "file_index")
    }
    begins = {f"videos/{COLUMN}/from_timestamp": [0.0, ROWS / HZ]}
    write(tmp_path / "meta/episodes/chunk-000/file-000.parquet", {"episode_index": [0, 1], **places, **begins})
    return write_info(
        tmp_path,
        "v3.0",
        data_path="data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        video_path="videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    )


@pytest.fixture
def hugging_face() -> datasets.Dataset:
    """A Hugging Face data set with a column of images, and both episodes."""
    first, second = make_rows(0), make_rows(1)
    rows = {key: first[key] + second[key] for key in first} | {"gel": [*make_images(0), *make_images(1)]}
    numbers = {key: datasets.Value("float64" if key == "timestamp" else "int64") for key in first}
    return datasets.Dataset.from_dict(rows, datasets.Features({**numbers, "gel": datasets.Image()}))


@pytest.fixture
def images() -> list[np.ndarray]:
    """The images (6, 96, 128, 3) of both episodes."""
    return [make_images(0), make_images(1)]


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """A video of the first episode."""
    write_video(tmp_path / "film.avi", make_images(0))
    return tmp_path / "film.avi"
