"""`tactile-loc calibrate`: learn to read a sensor's images from presses of known shapes."""

from __future__ import annotations

import dataclasses
import math
import os
import tempfile
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.errors import CalibrationError, ConfigError, SensorError
from tactile_loc.store.files import require_writable
from tactile_loc_cli.console import make_progress, say
from tactile_loc_cli.labelling import label_presses
from tactile_loc_cli.options import Store, declare, set_option

if TYPE_CHECKING:
    from tactile_loc.calibration.estimator import GelEstimator
    from tactile_loc.calibration.labels import Image, LabelledPresses
    from tactile_loc.calibration.presses import PressFolder
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

DEFAULT_OUT = Path("my_sensor")
DEFAULT_SENSOR = "gelslim"


Estimator = StrEnum("Estimator", "PHOTOMETRIC CNN")
Format = StrEnum("Format", "GS_SDK TAXIM FOTS CIRCLES")  # of public calibration sets
Background = StrEnum("Background", "TABLE MEDIAN")  # the source of the untouched gel's image

Folder = Annotated[
    Path | None,
    typer.Argument(
        metavar="FOLDER",
        help="Images or a video of presses, with their table presses.csv; --ball-radius writes a missing table.",
    ),
]
Geometry = Annotated[
    str | None,
    declare(
        "--sensor", "FILE.toml|NAME",
        "Sensor description. Default: FOLDER/sensor.toml. With --simulated also a sensor's name, by default gelslim.",
    ),
]  # fmt: skip
EstimatorName = Annotated[
    Estimator,
    typer.Option(
        "--estimator", help="photometric: slope from the colour of each pixel. cnn: a network for the whole image."
    ),
]
Untouched = Annotated[
    Background,
    typer.Option("--background", help="Image of the untouched gel: that of the table, or the median of all presses."),
]
PublicFormat = Annotated[
    Format | None, typer.Option("--format", help="FOLDER is a public calibration set of this format.")
]
BallRadius = Annotated[
    float | None,
    declare("--ball-radius", "MM", "Radius of the ball in mm. Needed if there is no presses.csv, and with --format."),
]
PixelSize = Annotated[
    float | None,
    declare(
        "--mm-per-px", "MM", "Size of a pixel on the gel in mm. Needed if there is no sensor.toml, and with --format."
    ),
]
ImageSize = Annotated[
    tuple[int, int] | None,
    declare(
        "--image-size", "WIDTH HEIGHT",
        "Reduce the images to this size in pixels. Default: at most 200 along the longer side. Labels stay in pixels "
        "of the original images.", min=16,
    ),
]  # fmt: skip
Simulated = Annotated[
    bool, typer.Option("--simulated", help="Instead of FOLDER: simulate presses of two calibration boards.")
]
Lamps = Annotated[
    str | None, declare("--optics", "NAME", "With --simulated: lamps of gelslim, gelsight-mini or digit.")
]
Presses = Annotated[
    int | None,
    declare(
        "--presses", "N", "With --simulated: number of presses. Default: 200, or 2000 for cnn.", min=5, max=100_000
    ),
]
Curved = Annotated[
    bool, typer.Option("--curved", help="Also learn the surface of a curved gel, from presses of a ball.")
]
EstimatorOption = Annotated[
    list[str] | None, set_option("Set an option of the estimator, such as steps=4000.", "OPTION=VALUE")
]
HeldOutSeed = Annotated[int, declare("--seed", "N", "Seed that chooses the held-out presses.", min=0)]
Out = Annotated[Path, declare("--out", "FOLDER", "Calibration folder to write.")]


def calibrate(
    folder: Folder = None,
    sensor: Geometry = None,
    estimator: EstimatorName = Estimator.PHOTOMETRIC,
    background: Untouched = Background.TABLE,
    format: PublicFormat = None,
    ball_radius: BallRadius = None,
    mm_per_px: PixelSize = None,
    image_size: ImageSize = None,
    curved: Curved = False,
    simulated: Simulated = False,
    optics: Lamps = None,
    presses: Presses = None,
    option: EstimatorOption = None,
    seed: HeldOutSeed = 0,
    out: Out = DEFAULT_OUT,
    store: Store = None,
) -> dict[str, Any]:
    """Calibrate a sensor to read its images.

    The command learns from presses of a ball, or of any mesh at a known pose. With --simulated, it learns from
    simulated presses. Without a table, it detects the ball in the images: check labels.png. A fifth of the presses is
    held out to measure the errors. Use the result with: run --object FILE --sensor FOLDER --touch photo.png
    """
    from tactile_loc.calibration.folder import require_replaceable

    require_writable(out)
    require_replaceable(out.absolute())
    chosen = _parse_options(option or [])
    _require_one_source(folder, format, background, image_size, curved, simulated, optics, presses)
    if folder is None:
        return _calibrate_simulated(sensor, optics, presses, estimator, chosen, seed, out, store)
    labels: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as temporary:
        if format is not None:
            folder = _convert(folder, Path(temporary), format, ball_radius, mm_per_px)
            file = folder / "sensor.toml" if sensor is None else Path(sensor)
        else:
            folder, file, labels = label_presses(folder, sensor, ball_radius, mm_per_px)
        done = _calibrate(folder, file, estimator, background, image_size, curved, chosen, seed, out, store)
        return {**done, **labels}


def _require_one_source(
    folder: Path | None, format: Format | None, background: Background, image_size: tuple[int, int] | None,
    curved: bool, simulated: bool, optics: str | None, presses: int | None,
) -> None:  # fmt: skip
    of_folder = folder, format, image_size
    if simulated and (any(given is not None for given in of_folder) or background is not Background.TABLE or curved):
        raise ConfigError(
            "--simulated needs no images; leave out FOLDER, --format, --background, --image-size and --curved"
        )
    if not simulated and folder is None:
        raise ConfigError("no presses are given; give FOLDER with images of presses, or --simulated")
    if not simulated and (optics is not None or presses is not None):
        raise ConfigError("--optics and --presses need --simulated; add it, or leave them out")


def _convert(source: Path, folder: Path, format: Format, ball_radius: float | None, mm_per_px: float | None) -> Path:
    from tactile_loc.calibration.presses import convert, write_sensor

    if not (ball_radius and ball_radius > 0 and mm_per_px and mm_per_px > 0):
        raise ConfigError(f"--format {format} needs --ball-radius and --mm-per-px, positive numbers in mm")
    convert(source, folder, format, ball_radius, mm_per_px)
    write_sensor(folder, mm_per_px)
    return folder


def _parse_options(words: list[str]) -> dict[str, Any]:
    from tactile_loc.io.config import parse_overrides

    for word in words:
        if not word.partition("=")[1]:
            raise ConfigError(f"the option {word!r} cannot be read; write OPTION=VALUE, such as steps=4000")
    return parse_overrides([f"sensor.{word}" for word in words]).get("sensor", {})  # parsing needs the name of a slot


def _calibrate(
    folder: Path, sensor: Path, estimator: Estimator, background: Background, image_size: tuple[int, int] | None,
    curved: bool, options: dict[str, Any], seed: int, out: Path, store: Path | None,
) -> dict[str, Any]:  # fmt: skip
    from tactile_loc.calibration.calibrate import calibrate_stage
    from tactile_loc.calibration.presses import choose_size_px, read_presses
    from tactile_loc.store.store import StageStore

    if not os.path.isdir(folder):
        raise CalibrationError(f"there is no folder {folder}; give a folder with images of presses and presses.csv")
    camera = _read_geometry(sensor)
    size_px = image_size or choose_size_px(camera)
    presses = read_presses(folder, camera, background is Background.MEDIAN, size_px)
    if curved:
        presses = _curve_gel(presses, seed)
    presses = presses.measure_gel(progress=make_progress())
    _say_gel(presses)
    made, record = calibrate_stage(presses, folder, estimator, options, seed, StageStore(store), make_progress())
    _say_dots(presses)
    return _finish(presses, made, presses.untouched, {**record, **presses.record()}, out)


def _say_dots(presses: PressFolder) -> None:
    dots = presses.record().get("dots", {})
    if dots.get("count"):
        say(
            f"the gel has {dots['count']} marker dots, {1e3 * dots['diameter_m']:.2f} mm wide and "
            f"{1e3 * dots['spacing_m']:.2f} mm apart; they cover {100 * dots['covered']:.0f} % of the image and are "
            "filled in"
        )


def _say_gel(presses: PressFolder) -> None:
    """Print the gel's elasticity, if the presses determine it."""
    fit, mm = presses.fit, 1e3
    if fit is None:
        return
    shares = f"{100 * fit.rms:.0f} % of the colour profiles unexplained, a rigid gel {100 * fit.rigid_rms:.0f} %"
    if fit.is_elastic:
        say(
            f"the gel is elastic: effective thickness {mm * fit.thickness_m:.1f} mm (standard deviation "
            f"{mm * fit.std_m:.1f} mm), coating {mm * fit.coating_m:.2f} mm; it leaves {shares}"
        )
    else:
        say(f"the gel is taken for rigid: an elastic gel leaves {shares}")


def _curve_gel(presses: PressFolder, seed: int) -> PressFolder:
    from tactile_loc.calibration.relief import learn_relief

    relief_m = learn_relief(presses, seed, make_progress())
    say(f"the gel is curved: its edge is up to {-1e3 * relief_m.min():.2f} mm lower than its top")
    return dataclasses.replace(presses, geometry=dataclasses.replace(presses.geometry, relief_m=relief_m))


def _calibrate_simulated(
    sensor: str | None, optics: str | None, count: int | None, estimator: Estimator, options: dict[str, Any],
    seed: int, out: Path, store: Path | None,
) -> dict[str, Any]:  # fmt: skip
    from tactile_loc.calibration.simulated import calibrate_simulated, find_camera_px, find_sensor
    from tactile_loc.store.store import StageStore

    sensor = sensor or DEFAULT_SENSOR
    geometry, lamps = find_sensor(sensor, optics)
    where = StageStore(store)
    presses, made, record = calibrate_simulated(
        geometry, lamps, count, estimator, options, seed, where, make_progress()
    )
    if (native := find_camera_px(sensor)) is not None:
        record["camera_px"] = native
    return _finish(presses, made, presses.background, record, out)


def _finish(
    presses: LabelledPresses, made: GelEstimator, background: Image, record: dict[str, Any], out: Path
) -> dict[str, Any]:
    from tactile_loc.calibration.folder import PICTURE, write_calibration
    from tactile_loc.drawing.calibration import draw_held_out
    from tactile_loc.drawing.pictures import save_figure

    write_calibration(out.absolute(), made.geometry, background, made, {"presses": len(presses), **record})
    held_out = record["held_out"]
    title = f"{len(held_out['presses'])} of {len(presses)} presses were held out"
    picture = save_figure(out / PICTURE, draw_held_out(made, presses, held_out["presses"], title))
    say(f"{title}; mean errors on these:")
    for line in _list_errors(held_out["mean"]):
        say(line)
    say(f"written: {out} (look at {picture})")
    say(f"use it with: tactile-loc run --object FILE --sensor {out} --touch IMAGE")
    held_out = {"presses": len(held_out["presses"]), "mean_errors": _convert_to_si(held_out["mean"])}
    return {"folder": str(out), "picture": str(picture), "presses": len(presses), "held_out": held_out}


def _read_geometry(path: Path) -> SensorGeometry:
    from tactile_loc.io.sensor_files import read_sensor_file

    if not os.path.isfile(path):
        raise SensorError(f"there is no sensor file {path}; write it (docs/files.md), or give --sensor")
    return read_sensor_file(path)


def _convert_to_si(mean: dict[str, float]) -> dict[str, float]:
    """Return the same errors, with angles in radians."""
    slope = {"slope_rad": math.radians(mean["slope_deg"])} if "slope_deg" in mean else {}
    return {**slope, **{name: value for name, value in mean.items() if name != "slope_deg"}}


def _list_errors(mean: dict[str, float]) -> list[str]:
    quantities = {
        "slope_deg": ("surface angle in the contact", 1, ".2f", "°"),
        "shape_m": ("indentation in the contact, up to a constant", 1e3, ".3f", " mm"),
        "depth_m": ("indentation in the contact", 1e3, ".3f", " mm"),
        "untouched_m": ("indentation outside the contact", 1e3, ".3f", " mm"),
    }
    return [
        f"  {label}: {scale * mean[name]:{digits}}{unit}"
        for name, (label, scale, digits, unit) in quantities.items()
        if name in mean
    ]
