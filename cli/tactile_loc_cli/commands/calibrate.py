"""`tactile-loc calibrate`: learn to read a sensor's images from presses of a ball."""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.runtime.errors import ConfigError, TactileLocError
from tactile_loc.store.files import require_writable
from tactile_loc_cli.console import make_progress, say, write_flags
from tactile_loc_cli.options import Store, declare, set_option

if TYPE_CHECKING:
    from tactile_loc.sensors.calibration.labelling import LabelledFolder
    from tactile_loc.sensors.calibration.outcome import CalibrationOutcome
    from tactile_loc.sensors.reading.rectification import StatedView

DEFAULT_OUT = Path("my_sensor")
Background = StrEnum("Background", "TABLE MEDIAN")  # the source of the untouched gel's image

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER",
        help="Images or a video of presses, with their table presses.csv; --ball-radius writes a missing table.",
    ),
]
Geometry = Annotated[str | None, declare("--sensor FILE.toml", "Sensor description. Default: FOLDER/sensor.toml.")]
Untouched = Annotated[
    Background, declare("--background", "Image of the untouched gel: that of the table, or the median of all presses.")
]
BallRadius = Annotated[
    float | None,
    declare("--ball-radius MM", "Radius of the ball in mm. Needed if neither presses.csv nor the set states it."),
]
PixelSize = Annotated[
    str | None,
    declare(
        "--mm-per-px MM[,MM]",
        "Size of a pixel on the gel in mm, or its width and height. Needed if neither sensor.toml nor the set states "
        "it, and --corners is not given.",
    ),
]
Corners = Annotated[
    tuple[float, float, float, float, float, float, float, float] | None,
    declare(
        "--corners X Y X Y X Y X Y",
        "For a tilted view: corners of a rectangle on the gel, in pixels of the photo, clockwise from the upper left.",
    ),
]
GelSize = Annotated[
    tuple[float, float] | None, declare("--gel-size WIDTH HEIGHT", "With --corners: the size of the rectangle in mm.")
]
CameraMatrix = Annotated[
    Path | None,
    declare("--camera-matrix FILE", "For a lens: camera matrix and distortion of OpenCV or ROS (YAML, JSON or TOML)."),
]
ImageSize = Annotated[
    tuple[int, int] | None,
    declare(
        "--image-size WIDTH HEIGHT",
        "Reduce the images to this size in pixels. Default: at most 200 along the longer side. Labels stay in pixels "
        "of the original images.",
        min=16,
    ),
]
EstimatorOption = Annotated[
    list[str] | None, set_option("Set an option of the estimator, such as steps=4000.", "OPTION=VALUE")
]
HeldOutSeed = Annotated[int, declare("--seed N", "Seed that chooses the held-out presses.", min=0)]
Out = Annotated[Path, declare("--out FOLDER", "Calibration folder to write.")]


def calibrate(
    folder: Folder,
    sensor: Geometry = None,
    background: Untouched = Background.TABLE,
    ball_radius: BallRadius = None,
    mm_per_px: PixelSize = None,
    corners: Corners = None,
    gel_size: GelSize = None,
    camera_matrix: CameraMatrix = None,
    image_size: ImageSize = None,
    option: EstimatorOption = None,
    seed: HeldOutSeed = 0,
    out: Out = DEFAULT_OUT,
    store: Store = None,
) -> dict[str, Any]:
    """Calibrate a sensor to read its images.

    The command learns from presses of a ball. Without a table, it detects the ball in the images: check labels.png. A
    fifth of the presses is held out to measure the errors. Use the result with: run --object FILE --sensor FOLDER
    --touch photo.png
    """
    from tactile_loc.sensors.calibration.folder import require_replaceable
    from tactile_loc.sensors.calibration.labelling import label_presses
    from tactile_loc.sensors.calibration.outcome import calibrate_measured, measure_folder
    from tactile_loc.sensors.reading.photometric import EstimatorRecipe
    from tactile_loc.store.store import StageStore

    require_writable(out)
    require_replaceable(out.absolute())
    recipe = EstimatorRecipe(_parse_options(option or []), seed)
    labels: dict[str, Any] = {}
    doubts: list[str] = []
    scale, view = _state_view(mm_per_px, corners, gel_size, camera_matrix)
    with tempfile.TemporaryDirectory() as temporary, _name_folder(temporary, folder):
        lines, converted = _convert(folder, Path(temporary), ball_radius, scale, view)
        if converted is not None:
            folder, file = converted, converted / "sensor.toml" if sensor is None else Path(sensor)
        else:
            labelled = label_presses(folder, sensor, ball_radius, scale, make_progress(), view)
            more, labels = _describe_labels(labelled, ball_radius)
            doubts = labelled.list_doubts()
            lines, folder, file = [*lines, *more], labelled.folder, labelled.sensor
        measured = measure_folder(folder, file, background is Background.MEDIAN, image_size, make_progress())
        for line in (*doubts, *measured.list_doubts(), *lines):
            say(write_flags(line))
        outcome = calibrate_measured(measured, recipe, StageStore(store), make_progress())
        return {**_finish(outcome, out), **labels}


@contextmanager
def _name_folder(temporary: str, source: Path) -> Iterator[None]:
    """Let errors of the block name the user's `source` instead of the temporary folder to which it was converted."""
    try:
        yield
    except TactileLocError as error:
        if temporary not in str(error):
            raise
        made = re.sub(rf"{re.escape(temporary)}/([a-z]+\.(?:csv|toml))", rf"\1 made from {temporary}", str(error))
        raise type(error)(made.replace(temporary, str(source))) from error


def _state_view(
    mm_per_px: str | None, corners: Sequence[float] | None, gel_size: tuple[float, float] | None, lens: Path | None
) -> tuple[float | None, StatedView | None]:
    """Return the mean size of a pixel, mm, and what else the options state about the camera's view; None if nothing."""
    from tactile_loc.io.sensor_files import read_lens
    from tactile_loc.sensors.reading.rectification import StatedView

    try:
        scales = [] if mm_per_px is None else [float(text) for text in mm_per_px.split(",")]
    except ValueError:
        scales = [math.nan]
    if len(scales) > 2 or not all(math.isfinite(scale) and scale > 0 for scale in scales):
        raise ConfigError(f"--mm-per-px cannot be {mm_per_px}; give a positive number, or two as in 0.06,0.05 (mm)")
    if len(scales) == 2 and (corners or lens):
        raise ConfigError("--corners and --camera-matrix give the ratio of width and height; give one --mm-per-px")
    scale = math.prod(scales) ** (1 / len(scales)) if scales else None
    if len(scales) < 2 and not (corners or gel_size or lens):
        return scale, None
    aspect = scales[0] / scales[1] if len(scales) == 2 else 1.0
    places = tuple(zip(corners[::2], corners[1::2], strict=True)) if corners else ()
    return scale, StatedView(aspect, places, gel_size, None if lens is None else read_lens(lens))


def _convert(
    source: Path, folder: Path, ball_radius: float | None, mm_per_px: float | None, view: StatedView | None
) -> tuple[list[str], Path | None]:
    """Return lines with the layout of the photos, and a converted folder if another tool has labelled them."""
    from tactile_loc.io.streams.videos import VIDEO_SUFFIXES
    from tactile_loc.sensors.calibration.layouts import convert_presses, recognise_set
    from tactile_loc.sensors.calibration.press_table import TABLE
    from tactile_loc.store.files import list_files

    if source.is_dir():
        if (source / TABLE).exists() or list_files(source, VIDEO_SUFFIXES):
            return [], None
    elif source.suffix.lower() != ".npz":
        return [], None
    found = recognise_set(source)
    converted = convert_presses(source, folder, ball_radius, mm_per_px, view).parent if found.circles else None
    return [found.describe()], converted


def _parse_options(words: list[str]) -> dict[str, Any]:
    from tactile_loc.io.config import parse_overrides

    for word in words:
        if not word.partition("=")[1]:
            raise ConfigError(f"the option {word!r} cannot be read; write OPTION=VALUE, such as steps=4000")
    return parse_overrides([f"sensor.{word}" for word in words]).get("sensor", {})  # parsing needs the name of a slot


def _describe_labels(labelled: LabelledFolder, ball_radius: float | None) -> tuple[list[str], dict[str, Any]]:
    """Return lines that say where the labels come from. Draw new labels, and return those for the command's result."""
    from tactile_loc.sensors.calibration.press_table import TABLE
    from tactile_loc.view.calibration import save_labels

    table = labelled.folder / TABLE
    if labelled.found is None:
        new = labelled.unlisted
        more = f"; {new} images are not in this table: remove it to detect the balls again" if new else ""
        return [f"using the labels in {table}{more}"] if ball_radius is not None else [], {}
    found, sheet = labelled.found, save_labels(labelled.folder, labelled.found)
    edit = "if a circle is wrong, edit its row and run the command again"
    dropped = {press.name: press.dropped for press in found.presses if press.dropped}
    labels = {"table": str(table), "sheet": str(sheet), "used": len(found.used), "dropped": dropped}
    return [*labelled.describe(), f"written: {table} (look at {sheet}; {edit})"], {"labels": labels}


def _finish(outcome: CalibrationOutcome, out: Path) -> dict[str, Any]:
    """Write the calibration folder, and print the gel's properties and the errors."""
    from tactile_loc.view.calibration import save_held_out

    outcome.write(out.absolute())
    picture = save_held_out(out, outcome)
    for fact in outcome.facts:
        say(write_flags(fact))
    say(f"{outcome.title}; mean errors on these:")
    for line in outcome.list_errors():
        say(f"  {line}")
    say(f"written: {out} (look at {picture})")
    say(f"use it with: tactile-loc run --object FILE --sensor {out} --touch IMAGE")
    held_out = {"presses": len(outcome.held_out), "mean_errors": outcome.convert_errors()}
    return {"folder": str(out), "picture": str(picture), "presses": len(outcome.presses), "held_out": held_out}
