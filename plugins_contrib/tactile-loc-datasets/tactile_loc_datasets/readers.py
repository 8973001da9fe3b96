"""Readers of episodes: LeRobot data sets (versions 2 and 3), and Hugging Face data sets with columns of images."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from datasets import Dataset, Image, load_from_disk
from pyarrow import parquet
from tactile_loc.plugin import ConfigError

from tactile_loc_datasets.episodes import USUAL_HZ, Episode
from tactile_loc_datasets.known_motions import POSES, TRIAL, read_round, read_trial

INFO = Path("meta", "info.json")  # of a LeRobot data set


def read_episode(path: Path, number: int | None = None, column: str | None = None) -> Episode:
    """Read an episode of a data set. `column` has the images; it may be left out if only one column has images.

    Without a `number`, it is the first episode of a LeRobot data set, the first round of Real Tactile MNIST, and all
    rows of another Hugging Face data set. Raises ConfigError for a data set that cannot be read, and for a missing
    episode or column.
    """
    if (path / TRIAL).is_file():
        return read_trial(path)
    try:
        return (read_lerobot if (path / INFO).is_file() else read_table)(path, number, column)
    except (OSError, ValueError, KeyError, StopIteration, pyarrow.ArrowException) as error:
        raise ConfigError(f"{path} cannot be read as a data set ({error}); check the path, or copy it again") from error


def read_lerobot(path: Path, number: int | None, column: str | None) -> Episode:
    """Read an episode of a LeRobot data set of version 2 or 3."""
    info, number = json.loads((path / INFO).read_text(encoding="utf-8")), number or 0
    if not 0 <= number < info["total_episodes"]:
        raise ConfigError(f"{path} has no episode {number}; it has {info['total_episodes']}, from 0 on")
    kinds = {name: feature["dtype"] for name, feature in info["features"].items()}
    column = choose(path, column, [name for name, kind in kinds.items() if kind in ("image", "video")], list(kinds))
    row: dict[str, Any] = {"episode_index": number}
    if str(info["codebase_version"]).startswith("v2"):
        row["episode_chunk"] = number // info["chunks_size"]
    else:
        rows = (row for file in sorted(path.glob("meta/episodes/*/*.parquet")) for row in list_places(file))
        row = next(row for row in rows if row["episode_index"] == number)
    file = path / info["data_path"].format(**keep(row, "data/"))
    table = Dataset(parquet.read_table(file, filters=[("episode_index", "=", number)]))
    times_s = np.array(table["timestamp"], float)
    name = f"episode {number} of {path}"
    if kinds[column] != "video":
        return Episode(name, column, table, times_s)
    places = keep(row, f"videos/{column}/")
    film = path / info["video_path"].format(video_key=column, **places)
    return Episode(name, column, table, times_s, film, places.get("from_timestamp", 0.0))


def list_places(file: Path) -> list[dict[str, Any]]:
    """Return where the episodes' rows and frames are, from a file of meta/episodes."""
    names = parquet.read_schema(file).names
    wanted = [name for name in names if name == "episode_index" or name.startswith(("data/", "videos/"))]
    rows: list[dict[str, Any]] = parquet.read_table(file, columns=wanted).to_pylist()
    return rows


def keep(row: dict[str, Any], prefix: str) -> dict[str, Any]:
    """Return the entries of a row that begin with a prefix, without it, and those without any prefix."""
    return {key.removeprefix(prefix): value for key, value in row.items() if key.startswith(prefix) or "/" not in key}


def read_table(path: Path, number: int | None, column: str | None) -> Episode:
    """Read a Hugging Face data set: Parquet files, or a folder that `Dataset.save_to_disk` wrote."""
    if (path / "state.json").is_file():
        table = load_from_disk(str(path))
    else:
        files = sorted([*path.glob("*.parquet"), *path.glob("data/*.parquet")]) if path.is_dir() else [path]
        if not files:
            raise ConfigError(f"{path} is no data set; give a LeRobot or a Hugging Face data set, or a Parquet file")
        table = Dataset(pyarrow.concat_tables(parquet.read_table(file) for file in files))
    if POSES in table.column_names:
        return read_round(path, table, number or 0)
    if number is not None:
        if "episode_index" not in table.column_names:
            raise ConfigError(f"{path} has no column episode_index; leave the episode out")
        table = table.select(np.flatnonzero(np.array(table["episode_index"]) == number))
        if not len(table):
            raise ConfigError(f"{path} has no episode {number}; choose another one")
    images = [name for name, feature in table.features.items() if isinstance(feature, Image)]
    column = choose(path, column, images, table.column_names)
    times_s = table["timestamp"] if "timestamp" in table.column_names else np.arange(len(table)) / USUAL_HZ
    return Episode(
        str(path) if number is None else f"episode {number} of {path}", column, table, np.array(times_s, float)
    )


def choose(path: Path, name: str | None, images: Sequence[str], names: Sequence[str]) -> str:
    """Return the column of images called `name`, or the only one. Raises ConfigError, which lists the columns."""
    if name is None and len(images) == 1:
        return images[0]
    if name is None or name not in names:
        problem = f"has no column {name!r}" if name else f"has {len(images)} columns of images"
        raise ConfigError(f"{path} {problem}; choose one by --column: {', '.join(images or names)}")
    return name
