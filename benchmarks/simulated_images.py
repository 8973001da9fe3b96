#!/usr/bin/env python3
"""Depths from simulated images of the demo objects. The estimator was trained only on simulated calibration boards.

The sensor is calibrated as by `tactile-loc calibrate --simulated`, or loaded from the store. Then it reads touches of
unseen objects at random poses, at the sensor's deepest press, under the nominal lamps. Errors of the indentation are
RMS over the whole image and over the contact. IoU is the overlap of the contact's mask with the true mask. Times are
medians on this machine. The output is a Markdown table.

With `--locate N`, the objects are also located from N images by the protocol of `tactile-loc paper`, and
from clean contact shapes of the same touches. A second table has the results for each `--encoder`, on grids of about
`--poses` poses.
"""

import argparse
import logging
import tempfile
import time
from pathlib import Path

import numpy as np
from asked import write_head
from single_touch import choose_spacing
from tactile_loc_benchmark.suite import read_split

from tactile_loc import Localizer, StageStore, Touch, load_object
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation.paper_tables import normalise_errors
from tactile_loc.evaluation.protocol import evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.io.config import RunConfig, parse_overrides
from tactile_loc.plugin import TouchError
from tactile_loc.sensors.calibration.simulated import SimulatedSensor, calibrate_simulated
from tactile_loc.sensors.optics.lamps import Optics
from tactile_loc.sensors.optics.simulate import find_indentation, press_gel, render_touches
from tactile_loc.sensors.reading.estimator import EstimatorRecipe, GelEstimator
from tactile_loc.sensors.reading.reading import find_contact_shape, measure_press_m

BATCH = 10
COLUMNS = ("object", "RMSE, image (mm)", "RMSE, contact (mm)", "IoU", "least IoU", "press error (mm)", "ms an image")


def measure(estimator: GelEstimator, noise_m: float, touches: list[Touch], lamps: Optics) -> np.ndarray:
    """Return a row of numbers for each of N touches, in the order of `COLUMNS`, in mm, shares and ms."""
    rows, rng = [], np.random.default_rng(0)
    for start in range(0, len(touches), BATCH):
        some = touches[start : start + BATCH]
        depth_m, press_m = np.stack([t.contact_shape.depth_m for t in some]), [t.press_depth_m for t in some]
        images = render_touches(depth_m, press_m, estimator.geometry, lamps, rng)
        known = (
            press_gel(depth_m, press_m, estimator.geometry)
            if estimator.sees_skirt
            else find_indentation(depth_m, press_m)
        )
        rows += [
            measure_errors(estimator, noise_m, t, image, truth)
            for t, image, truth in zip(some, images, known, strict=True)
        ]
    return np.array(rows)


def measure_errors(
    estimator: GelEstimator, noise_m: float, touch: Touch, image: np.ndarray, known_m: np.ndarray
) -> tuple[float, ...]:
    """Return the errors of one touch. The IoU is 0 if no contact is found in the image."""
    observed = estimator.geometry.observed_mask
    start = time.perf_counter()
    found_m = estimator.read_indentation(image)
    took_ms = 1e3 * (time.perf_counter() - start)
    off_mm = 1e3 * (found_m - known_m)
    try:
        shape = find_contact_shape(found_m, estimator.geometry, noise_m, estimator.sees_skirt)
    except TouchError:
        iou = 0.0
    else:
        true = touch.contact_shape.press_to(shape.press_depth_m) if estimator.sees_skirt else touch.contact_shape
        iou = shape.contact_iou(true, observed)
    press_mm = 1e3 * abs(measure_press_m(found_m, estimator.geometry) - touch.press_depth_m)
    inside = off_mm[touch.contact_shape.contact & observed]
    return (*(float(np.sqrt(np.mean(np.square(part)))) for part in (off_mm[observed], inside)), iou, press_mm, took_ms)


def write_row(name: str, values: np.ndarray) -> str:
    """Return a row of the table: means over touches, the least IoU, and the median time."""
    image, contact, iou, press, _ = values.mean(axis=0)
    numbers = (f"{v:.3f}" for v in (image, contact, iou, values[:, 2].min(), press))
    return f"| {name} | {' | '.join(numbers)} | {np.median(values[:, 4]):.0f} |"


LINES, WHAT = ("best-1", "reg-1"), ("shapes", "images")


def locate(name: str, sensor: Path, encoder: str, arguments: argparse.Namespace) -> str:
    """Return a row of the second table: an object's median errors, in mm, from contact shapes and from images."""
    obj = load_object(name, "auto")
    spacing_mm = choose_spacing(obj, {"sensor": arguments.sensor}, arguments.poses)
    config = RunConfig.from_dict({
        "sensor": {"name": "calibrated", "path": str(sensor)}, "encoder": encoder,
        "grid": {"name": "face", "spacing_mm": spacing_mm},
    })  # fmt: skip
    localizer = Localizer(config, obj, StageStore(arguments.store))
    shapes, images = (
        evaluate(localizer, arguments.locate, SimulatedTouches(seed=arguments.seed, images=i)) for i in (False, True)
    )
    cells = [f"{format_mm(float(np.median(e.errors_m(line, 'add'))))} ({np.median(normalise_errors(e, line)):.3f})"
             for line in LINES for e in (shapes, images)]  # fmt: skip
    closest = format_mm(float(np.median(shapes.errors_m("closest", "add"))))
    return f"| {obj.name} | {localizer.model.size} | {encoder} | {' | '.join(cells)} | {closest} |"


def main() -> None:
    """Calibrate, measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensor", default="gelslim")
    parser.add_argument("--estimator", default="cnn")
    parser.add_argument("--presses", type=int, help="presses of the boards; default: the estimator's number")
    parser.add_argument("-o", "--option", action="append", default=[], metavar="OPTION=VALUE")
    parser.add_argument("--touches", type=int, default=30)
    parser.add_argument("--seed", type=int, default=7, help="seed of the touches")
    parser.add_argument("--locate", type=int, default=0, metavar="N", help="touches to locate for each object")
    parser.add_argument("--encoder", action="append", metavar="NAME", help="for --locate; may be repeated")
    parser.add_argument("--poses", type=int, default=10_000, help="approximate poses of a grid, for --locate")
    parser.add_argument("--store", type=Path)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    logging.getLogger("tactile_loc.sensors").setLevel(logging.INFO)
    sensor = SimulatedSensor.find(arguments.sensor)
    options = parse_overrides([f"sensor.{word}" for word in arguments.option]).get("sensor", {})
    start = time.perf_counter()
    recipe = EstimatorRecipe(arguments.estimator, options)
    done = calibrate_simulated(sensor, arguments.presses, recipe, StageStore(arguments.store))
    held_out = ", ".join(f"{k} {v:.3g}" for k, v in done.mean_errors.items())
    seconds = time.perf_counter() - start
    print(f"{arguments.estimator}, {len(done.presses)} presses, {seconds:.0f} s; held out: {held_out}\n")
    print(write_head(*COLUMNS))
    measured = []
    for name in read_split("demo"):
        touches = Localizer.create(name, sensor=arguments.sensor).simulate(arguments.touches, seed=arguments.seed)
        measured.append(measure(done.estimator, done.record["noise_m"], touches, sensor.optics))
        print(write_row(name, measured[-1]), flush=True)
    print(write_row("all", np.concatenate(measured)))
    if not arguments.locate:
        return
    names = ["object", "poses", "encoder", *(f"{line} from {what}" for line in LINES for what in WHAT), "closest"]
    print(f"\n{write_head(*names)}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = done.write(Path(temporary) / "sensor")
        for encoder in arguments.encoder or ["pixel"]:
            for name in read_split("demo"):
                print(locate(name, folder, encoder, arguments), flush=True)


if __name__ == "__main__":
    main()
