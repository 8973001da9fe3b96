#!/usr/bin/env python3
"""False alarms of `tactile-loc inspect` on undamaged objects in real photos.

Two sensors are calibrated on four fifths of their photos of a ball, `--splits` times. The photos that were held out
show an undamaged object, the ball, and are inspected three at a time. The sensor poses are those of the labelled
circles. The first sensor also has photos of a prism at four presses: every two or more of them are one inspection. Its
sensor poses are those of the tip's outline and the stated press. Objects are located first. Each inspection is at the
first pose, also if the verdict is not `certain`.

False alarms are inspections that report a difference or another pose. `stated` is the median of the stated heights.
"""

import itertools
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from asked import make_data_parser, write_head
from real_images import PRESSES_MM, SETS, TIP_Z_M, _read_image, _resize, _write_pose, read, reduce
from tactile_loc_inspect.inspection import Inspection, inspect_localization

from tactile_loc import EstimatorRecipe, Localization, Localizer, StageStore, Touch
from tactile_loc.plugin.helpers import invert
from tactile_loc.sensors.calibration.gel_fit import BallImage
from tactile_loc.sensors.calibration.outcome import calibrate

SENSORS = ("gelslim", "GelSight Mini")
TOGETHER = 3  # photos of a ball in an inspection
ALARMS = ("differs", "another pose")  # verdicts
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])  # the object's z points to the gel


def place_touch(touch: Touch, turned: np.ndarray, x_m: float, y_m: float, z_m: float) -> Touch:
    """Return a touch whose sensor pose follows from an object's rotation (4, 4) and origin, metres, at the gel.

    z_m is the height of the origin beyond the undeformed gel.
    """
    T = turned.copy()
    T[:3, 3] = x_m, y_m, touch.geometry.surface_m + z_m
    return replace(touch, T_base_sensor=invert(T))


def press_ball(localizer: Localizer, ball: BallImage) -> Touch | None:
    """Return the touch in the photo of a ball, with the sensor pose of its labelled circle."""
    touch = localizer.find_touch(ball.image)
    if touch is None:
        return None
    geometry, circle = touch.geometry, ball.circle
    least_m = np.sqrt(max(ball.ball_m**2 - (circle.radius_px * geometry.pixel_pitch_m) ** 2, 0))  # at the circle
    x_m, y_m = (circle.x_px - geometry.cx) / geometry.fx, (circle.y_px - geometry.cy) / geometry.fy
    return place_touch(touch, DOWN, x_m, y_m, float(least_m))


def press_prism(localizer: Localizer, shapes: Path) -> Iterator[Touch]:
    """Yield the touches in the photos of the prism."""
    poses = json.loads((shapes / "poses.json").read_text())
    for press in PRESSES_MM:
        image, pose = _read_image(shapes / f"prism_{press}_real.png"), _write_pose(poses, press)
        touch = localizer.find_touch(_resize(image, localizer.sensor.geometry.shape))
        assert touch is not None
        angle, pitch_m = np.radians(pose["theta_deg"]), 1e-3 * pose["mm_per_px"]
        turned = DOWN.copy()
        turned[:2, :2] = [[np.cos(angle), np.sin(angle)], [np.sin(angle), -np.cos(angle)]]
        x_m, y_m = pitch_m * (np.array(pose["origin_px"]) + 0.5 - np.array(image.shape[1::-1]) / 2)
        yield place_touch(touch, turned, x_m, y_m, TIP_Z_M - 1e-3 * float(press))


def inspect_sets(localizer: Localizer, sets: Sequence[Sequence[Touch]]) -> Iterator[tuple[Localization, Inspection]]:
    """Yield the result and the inspection of each set of touches."""
    for some in sets:
        located = localizer.localize(some)
        yield located, inspect_localization(located, 1)


def inspect_sensor(name: str, data: Path, splits: int, work: Path) -> Iterator[tuple[str, Localization, Inspection]]:
    """Yield the object, the result and the inspection of each set of photos of a sensor."""
    presses = reduce(read(name, data, work / name), name, work / name).measure_gel()
    trimesh.creation.icosphere(5, SETS[name][1]).export(work / "ball.stl")
    for seed in range(splits):
        calibrated, sensor = calibrate(presses, EstimatorRecipe(seed=seed)), work / f"{name}-{seed}"
        calibrated.write(sensor)
        settings = {"sensor": {"name": "calibrated", "path": str(sensor)}, "store": StageStore(work / "store")}
        ball = Localizer.create(work / "ball.stl", units="mm", symmetry="sphere", **settings)
        pressed = [one for n in calibrated.held_out if (one := press_ball(ball, presses.read_ball(n)))]
        sets = [pressed[n : n + TOGETHER] for n in range(0, len(pressed) - TOGETHER + 1, TOGETHER)]
        yield from ((f"ball, {name}", *one) for one in inspect_sets(ball, sets))
        if name == SENSORS[0]:
            prism = Localizer.create(data / "gelslim_shapes" / "prism.stl", units="mm", symmetry="z2", **settings)
            touches = list(press_prism(prism, data / "gelslim_shapes"))
            sets = [some for count in (2, 3, 4) for some in itertools.combinations(touches, count)]
            yield from ((f"prism, {name}", *one) for one in inspect_sets(prism, sets))


def main() -> None:
    """Measure, and print a table."""
    parser = make_data_parser(__doc__)
    parser.add_argument("--splits", type=int, default=2)
    arguments = parser.parse_args()
    rows: dict[str, list[tuple[Localization, Inspection]]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for name in SENSORS:
            for what, located, clean in inspect_sensor(name, arguments.data, arguments.splits, Path(temporary)):
                rows.setdefault(what, []).append((located, clean))
    print(write_head("object, sensor", "inspections", "certain", "false alarms", "not enough touches", "stated, mm"))
    for what, some in rows.items():
        verdicts = [clean.verdict for _, clean in some]
        certain = sum(located.verdict == "certain" for located, _ in some)
        stated = np.median([1e3 * clean.detectable_m for _, clean in some if clean.verdict == "as the model"])
        counts = (len(some), certain, *(sum(map(verdicts.count, of)) for of in (ALARMS, ("not enough touches",))))
        print(f"| {what} | {' | '.join(map(str, counts))} | {stated:.2f} |")


if __name__ == "__main__":
    main()
