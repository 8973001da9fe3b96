"""An episode of a data set: the images and times of its rows, and the table that results are added to."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import av
import numpy as np
from datasets import Dataset, disable_progress_bars
from numpy.typing import NDArray
from tactile_loc import SourceFrame, TactileLocError
from tactile_loc.commands import write_atomically
from tactile_loc.plugin import Poses, TouchError

USUAL_HZ = 30.0  # of rows without times
disable_progress_bars()  # tactile-loc shows the progress


@dataclass(frozen=True, eq=False)
class Episode:
    """The rows of one episode, or of a whole Hugging Face data set, in order.

    The images are in the `column` of the `table` or, if there is a `video`, in its frames from `begin_s` on, seconds.
    `times_s` (N,) are the times of the rows, seconds. `T_base_gel` (N, 4, 4), metres, are the poses of the gel, if
    the data set has them.
    """

    name: str
    column: str
    table: Dataset
    times_s: NDArray[np.float64]
    video: Path | None = None
    begin_s: float = 0.0
    T_base_gel: Poses | None = None

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
