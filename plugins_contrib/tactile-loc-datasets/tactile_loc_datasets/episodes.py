"""Episodes of LeRobot data sets (versions 2 and 3), and Hugging Face data sets with columns of images."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow
from datasets import Dataset, Image, disable_progress_bars, load_from_disk
from numpy.typing import NDArray
from pyarrow import parquet
from tactile_loc import SourceFrame, TactileLocError
from tactile_loc.commands import write_atomically
from tactile_loc.plugin import ConfigError, TouchError

INFO = Path("meta", "info.json")  # of a LeRobot data set
USUAL_HZ = 30.0  # of rows without times
disable_progress_bars()  # tactile-loc shows the progress


@dataclass(frozen=True, eq=False)
class Episode:
    """The rows of one episode, or of a whole Hugging Face data set, in order.

    The images are in the `column` of the `table` or, if there is a `video`, in its frames from `begin_s` on, seconds.
    `times_s` (N,) are the times of the rows, seconds.
    """

    name: str
    column: str
    table: Dataset
    times_s: NDArray[np.float64]
    video: Path | None = None
    begin_s: float = 0.0

    def read_frames(self) -> Iterator[SourceFrame]:
        """Yield a frame for each row. Raises TouchError if the video ends before the rows."""
        number = -1
        for number, image in enumerate(islice(self._read_images(), len(self.times_s))):
            problem = image if isinstance(image, TactileLocError) else None
            pixels = None if isinstance(image, TactileLocError) else image
            yield SourceFrame(number, float(self.times_s[number]), f"row-{number:06d}", pixels, problem=problem)
        if number + 1 < len(self.times_s):
            raise TouchError(f"{self.video} ends {len(self.times_s) - number - 1} frames early; copy it again")

    def _read_images(self) -> Iterator[NDArray[Any] | TactileLocError]:
        if self.video is not None:
            yield from read_video(self.video, self.begin_s)
            return
        images = self.table.select_columns([self.column])
        for number in range(len(images)):
            try:
                yield convert_image(images[number][self.column])
            except (OSError, ValueError, TypeError):
                yield TouchError("the image is damaged, or no image of 8-bit colours; check the column")

    def write(self, path: Path, columns: dict[str, Sequence[Any]]) -> Path:
        """Write the rows with further columns as Parquet, and return the path. Raises OutputError if that fails."""
        table = self.table
        for name, values in columns.items():
            table = table.add_column(name, list(values))
        return write_atomically(path, lambda file: table.to_parquet(file))


def convert_image(value: Any) -> NDArray[Any]:
    """Return the pixels of a value in a column: colours (H, W, 3), grey (H, W) uint8, or depths (H, W) float32."""
    if isinstance(value, list):
        depths = np.array(value, np.float32)
        if depths.ndim != 2:
            raise ValueError("depths must have rows and columns")
        return depths
    return np.array(value if value.mode in ("RGB", "L") else value.convert("RGB"))


def read_video(path: Path, begin_s: float) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames (H, W, 3) of a video from a time on, seconds. Raises TouchError if it cannot be read."""
    try:
        with av.open(str(path)) as film:
            stream = film.streams.video[0]
            half_s = 0.5 / float(stream.average_rate or USUAL_HZ)
            film.seek(int(begin_s / stream.time_base), stream=stream)  # to the key frame before
            for frame in film.decode(stream):
                if frame.time is not None and frame.time > begin_s - half_s:
                    yield frame.to_ndarray(format="rgb24")
    except (OSError, ValueError, av.FFmpegError) as error:
        raise TouchError(f"{path} cannot be read as a video ({error}); copy it again") from error


def read_episode(path: Path, number: int | None = None, column: str | None = None) -> Episode:
    """Read an episode of a data set. `column` has the images; it may be left out if only one column has images.

    Without a `number`, it is the first episode of a LeRobot data set, and all rows of a Hugging Face data set. Raises
    ConfigError for a data set that cannot be read, and for a missing episode or column.
    """
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
