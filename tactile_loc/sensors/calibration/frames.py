"""Reads images of presses that have no table yet: the pictures in a folder, and chosen frames of a video.

The chosen frames show the untouched gel, and each touch at its deepest. They are written to a folder beside the video,
so that a table can name them.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import CalibrationError, TouchError
from tactile_loc.core.runtime.formatting import is_unicode
from tactile_loc.io.images import IMAGE_SUFFIXES, read_photo, write_image
from tactile_loc.io.streams.videos import VIDEO_SUFFIXES, read_video
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.calibration.layouts import SHEET, recognise_set
from tactile_loc.sensors.reading.reading import reduce_image
from tactile_loc.store.files import list_files, replace_folder, shorten_name

THUMBNAIL_PX = 64  # longer side
QUIET = 0.1  # share of a video's frames, nearest to the median frame, that is taken as the untouched gel
TOUCHED = 0.3  # change above which the gel is touched, between the smallest change (0) and the largest (1)
MOST_UNTOUCHED = 5  # largest number of chosen frames of the untouched gel

Frames = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PressImage:
    """An image (H, W, 3) of the gel, and its path relative to the folder of the table."""

    name: str
    image: Image


def read_frames(source: Path) -> tuple[Path, list[PressImage]]:
    """Return the folder of a source's pictures, and the pictures as frames in order.

    The source is a folder of pictures and videos, a video, or a set of pictures that `recognise_set` finds. A video's
    chosen frames are written to the folder NAME-frames beside the video. Raises CalibrationError when there are no
    pictures, when a picture cannot be read, or when pictures differ in size.
    """
    if not os.path.exists(source):
        raise CalibrationError(f"there is no {source}; give a folder with images of presses, or a video")
    folder = take_frames(source) if os.path.isfile(source) else source
    frames = []
    for path in _list_pictures(folder):
        try:
            frames.append(PressImage(path.relative_to(folder).as_posix(), read_photo(path)))
        except TouchError as error:
            raise CalibrationError(str(error)) from error
    if not frames:
        raise CalibrationError(f"there is no image in {folder}; give photos of presses, PNG or JPEG, or a video")
    for frame in frames:
        if frame.image.shape != frames[0].image.shape:
            one, other = (f"{f.name} ({f.image.shape[1]} x {f.image.shape[0]} px)" for f in (frames[0], frame))
            raise CalibrationError(
                f"{folder} holds images of different sizes, {one} and {other}; give images of one camera"
            )
    return folder, frames


def list_pictures(folder: Path) -> set[str]:
    """Return the paths of the pictures in a folder, relative to it, except the sheet of labels."""
    return {path.relative_to(folder).as_posix() for path in _list_pictures(folder)}


def _list_pictures(folder: Path) -> list[Path]:
    """Return the pictures of a folder, and the chosen frames of its videos."""
    videos = list_files(folder, VIDEO_SUFFIXES)
    if videos:
        parts = [folder, *map(take_frames, videos)]
        found = [path for part in parts for path in list_files(part, IMAGE_SUFFIXES) if path.name != SHEET]
    else:
        found = [photo for photo in recognise_set(folder).photos.values() if isinstance(photo, Path)]
    for path in [*videos, *found]:
        if not is_unicode(path.name):
            raise CalibrationError(f"the name of {path} is not Unicode, so no table can list it; rename the file")
    return found


def take_frames(video: Path) -> Path:
    """Write the chosen frames of a video to the folder NAME-frames beside the video, and return the folder.

    A folder that already exists is returned unchanged. Raises CalibrationError when the video cannot be read or shows
    no touch.
    """
    folder = name_frames_folder(video)
    if folder.is_dir():
        return folder
    thumbnails = np.stack([_shrink(image) for image in read_video(video)])
    chosen = set(choose_frames(thumbnails))
    if not chosen:
        raise CalibrationError(f"{video} shows no touch: its frames hardly differ; record the ball while it is pressed")
    digits = len(str(len(thumbnails)))
    with replace_folder(folder, fresh=True) as temporary:
        for number, image in enumerate(read_video(video)):
            if number in chosen:
                write_image(temporary / f"{number:0{digits}d}.png", image)
    return folder


def name_frames_folder(video: Path) -> Path:
    """Return the folder for the chosen frames of a video."""
    return video.with_name(f"{shorten_name(video.stem)}-frames")


def _shrink(image: Image) -> Frames:
    step = max(1.0, max(image.shape[:2]) / THUMBNAIL_PX)
    shape = (max(1, round(image.shape[0] / step)), max(1, round(image.shape[1] / step)))
    return reduce_image(image, shape).astype(np.float32)


def choose_frames(thumbnails: Frames) -> list[int]:
    """Return the numbers of the frames that show the untouched gel, or a touch at its deepest.

    `thumbnails` (N, h, w, 3) are all frames of a video, reduced in size. A touch is a sequence of frames with a change
    above TOUCHED. The deepest frame of a touch has the largest change. The result is empty when no frame differs
    clearly from the others.
    """
    typical = np.median(thumbnails[:: max(1, len(thumbnails) // 200)], axis=0)
    nearest = np.argsort(_measure_changes(thumbnails, typical))[: max(1, round(QUIET * len(thumbnails)))]
    change = _measure_changes(thumbnails, np.median(thumbnails[nearest], axis=0))
    low, high = float(np.quantile(change, 0.05)), float(change.max())
    if high < 2 * low + 1:
        return []
    touched = change > low + TOUCHED * (high - low)
    starts = np.flatnonzero(np.diff(touched, prepend=False) & touched)
    ends = np.flatnonzero(np.diff(touched, append=False) & touched) + 1
    deepest = [a + int(change[a:b].argmax()) for a, b in zip(starts.tolist(), ends.tolist(), strict=True)]
    return sorted({*deepest, *np.argsort(change)[:MOST_UNTOUCHED].tolist()})


def _measure_changes(thumbnails: Frames, reference: Frames) -> NDArray[np.float64]:
    """Return the root mean square difference (N,) of frames (N, h, w, 3) from an image (h, w, 3), counts."""
    return np.sqrt(((thumbnails - reference) ** 2).mean(axis=(1, 2, 3), dtype=np.float64))
