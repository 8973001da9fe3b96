#!/usr/bin/env python3
"""The errors of locating objects on an elastic gel, and those from assuming that the gel is rigid.

Objects are pressed from any direction, by 30 to 90 % of the sensor's deepest press. They are drawn by ray casting, and
the gel's surface is computed by ContactMechanics, neither of which the localizer uses. Each touch is located with the
elasticity of the gel, and as if the gel were rigid. Touches on a rigid gel are the reference. For one touch, the table
has the share with any hypothesis within 1 mm of pose error. For three touches, it has the shares of first poses within
1 and 0.2 mm, and with a shape distance of at most 1 mm. An example is determined if no listed pose beyond 1 mm explains
the touches as well as the true pose: to within 0.02 of its imprint IoU. The times are medians. An example that ends in
an error counts as not located.

Meshes are given as FILE[:UNITS] or a demo object's name.
"""

import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np
from asked import make_parser, make_source, name_asked, open_asked
from numpy.typing import NDArray
from tactile_loc_benchmark.sources.elastic import FAR_M, make_shape
from tactile_loc_benchmark.sources.layer import press_layer
from tactile_loc_benchmark.suite import read_split

from tactile_loc import ContactShape, Localizer, SensorGeometry, StageStore, TactileLocError, Touch, localize_together
from tactile_loc.core.poses.pose_errors import RIGHT_M, measure_pose_errors
from tactile_loc.core.poses.tolerance import measure_shape_distances
from tactile_loc.core.sensing.gel import RIGID, Gel
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.evaluation.recall.evaluation import is_determined
from tactile_loc.evaluation.robot_touches import RobotTouches, measure_noisily
from tactile_loc.plugin import Scene

MM = 1e3
VERY_THICK_MM = 1e3  # acts as a half-space
SIZES_PX = {"gelsight-mini": (160, 120), "gelslim": (160, 160)}  # at which ContactMechanics solves a touch in a second
CASES = ("elastic, located as elastic", "elastic, taken for rigid", "rigid")
RIGHT_MM, NEAR_MM = MM * RIGHT_M, 0.2
Columns = tuple[list[float], list[float], list[float], list[float], list[float], list[float]]


def deform(depth_m: NDArray[np.float32], press_m: float, geometry: SensorGeometry, gel: Gel) -> ContactShape:
    """Return the contact shape that ContactMechanics computes, given the depths (H, W), metres, in a rigid gel."""
    reach_m = np.where(depth_m < press_m, press_m - depth_m, -FAR_M)
    return make_shape(press_layer(reach_m, geometry, gel.thickness_m or 0.0, gel.poisson), press_m)


def press_elastic(touch: Touch, source: RobotTouches, gel: Gel) -> Touch:
    """Return the touch of a pressed object on an elastic gel, given its touch on a rigid gel."""
    press_m = touch.indentation_m
    geometry = source.geometry.press(press_m)
    rigid = Scene(source.object, geometry, source.renderer).render_contact_depths(touch.T_sensor_object[None])  # type: ignore[index]
    shown = deform(rigid[0], press_m, geometry, gel)
    elastic = dataclasses.replace(source.geometry, gel=gel)
    return dataclasses.replace(touch, contact_shape=shown, geometry=elastic)


def measure(localizer: Localizer, examples: list[list[Touch]]) -> Columns:
    """Return, of each example, the errors, mm, the times, ms, and whether all touches determine the pose, 0 or 1.

    The columns are the errors of the nearest pose of one touch and of the first pose of all touches, both times,
    `is_determined`, and the shape distance of the first pose of all touches, mm.
    """
    columns: Columns = ([], [], [], [], [], [])
    nearest_mm, first_mm, one_ms, all_ms, determined, shape_mm = columns
    for touches in examples:
        truth = np.asarray(touches[0].T_sensor_object)
        for some, kept, kept_ms in ((touches[:1], nearest_mm, one_ms), (touches, first_mm, all_ms)):
            start = time.perf_counter()
            try:
                found = localize_together([(localizer, touch) for touch in some])
            except TactileLocError:
                kept.append(np.inf)
                determined += [1.0] * (kept is first_mm)
                shape_mm += [np.inf] * (kept is first_mm)
                continue
            kept_ms.append(1e3 * (time.perf_counter() - start))
            poses = np.stack([h.T_sensor_object for h in found.hypotheses])
            errors_m = measure_pose_errors(localizer.object, poses, truth)
            kept.append(MM * float(errors_m[0] if kept is first_mm else errors_m.min()))
            if kept is first_mm:
                observations = [(localizer, touch) for touch in touches]
                determined.append(float(is_determined(observations, found.hypotheses, errors_m)))
                shape_mm.append(MM * float(measure_shape_distances(localizer.object.mesh, poses[:1], truth)[0]))
    return columns


def write_row(name: str, case: str, found: Columns) -> str:
    """Return a row of the table."""
    nearest, first, one_ms, all_ms, determined, shape = (np.array(values) for values in found)
    sure = first[determined == 1]
    share = f"{(sure <= RIGHT_MM).mean():.0%} of {len(sure)}" if len(sure) and case != CASES[1] else "-"
    return (
        f"| {name} | {case} | {(nearest <= RIGHT_MM).mean():.0%} | {np.median(one_ms):.0f} | "
        f"{(first <= RIGHT_MM).mean():.0%} | {share} | {(first <= NEAR_MM).mean():.0%} | "
        f"{(shape <= RIGHT_MM).mean():.0%} | {np.median(all_ms):.0f} |"
    )


def main() -> None:
    """Measure, and print a table."""
    parser = make_parser(__doc__, read_split("demo"))
    parser.add_argument("--sensor", choices=list(SIZES_PX), default="gelsight-mini")
    parser.add_argument("--thickness-mm", type=float, default=4.0, help="of the elastic layer; inf for a half-space")
    parser.add_argument("--poisson", type=float, default=0.48)
    parser.add_argument("--touches", type=int, default=3)
    parser.add_argument("--examples", type=int, default=12)
    parser.add_argument("--seed", type=int, default=31)
    arguments = parser.parse_args()
    gel = Gel(arguments.thickness_mm / MM, arguments.poisson)
    print(
        "| object | gel | one touch listed within 1 mm | one, ms | within 1 mm | of the determined | within 0.2 mm | "
        "shape within 1 mm | all, ms |\n|---|---|---|---|---|---|---|---|---|"
    )
    total: dict[str, Columns] = {case: ([], [], [], [], [], []) for case in CASES}
    with tempfile.TemporaryDirectory() as folder:
        store = StageStore(Path(folder))
        for name in arguments.objects:
            sensor = {"name": arguments.sensor, "image_size_px": SIZES_PX[arguments.sensor]}
            layer = {
                **sensor,
                "gel": "layer",
                "gel_thickness_mm": min(arguments.thickness_mm, VERY_THICK_MM),
                "poisson": arguments.poisson,
            }
            elastic, rigid = (open_asked(name, store=store, sensor=one) for one in (layer, sensor))
            source = make_source(rigid.object, rigid.scene.geometry)
            drawn = [
                source.draw_example(arguments.touches, np.random.default_rng([arguments.seed, number]))[0]
                for number in range(arguments.examples)
            ]
            modelled = elastic.scene.geometry.gel  # the solver that draws a half-space knows no thickness
            soft = [[view_as(press_elastic(touch, source, gel), modelled) for touch in touches] for touches in drawn]
            taken = [[view_as(touch, RIGID) for touch in touches] for touches in soft]
            for case, localizer, examples in zip(CASES, (elastic, rigid, rigid), (soft, taken, drawn), strict=True):
                localize_together([(localizer, touch) for touch in examples[0]])  # builds what is stored
                found = measure(localizer, examples)
                for values, more in zip(total[case], found, strict=True):
                    values.extend(more)
                print(write_row(name_asked(name), case, found), flush=True)
    for case in CASES:
        print(write_row("all", case, total[case]))


def add_noise(touch: Touch, source: RobotTouches, noise: TouchNoise, rng: np.random.Generator) -> Touch:
    """Return the touch with noise. Raises TouchError if a sensor cannot distinguish it from no touch."""
    press_m, deepest_m = touch.indentation_m, source.geometry.max_depth_m
    geometry = source.geometry.press(press_m, deepest_m)
    depth_m = touch.contact_shape.depth_m
    clean = np.where(depth_m < np.float32(press_m), depth_m, np.float32(deepest_m))
    seen_m, measured_m = measure_noisily(noise, clean[None], press_m, geometry, rng)
    unpressed = dataclasses.replace(source.geometry, gel=touch.geometry.gel)
    return dataclasses.replace(touch, contact_shape=ContactShape(seen_m, measured_m), geometry=unpressed)


def view_as(touch: Touch, gel: Gel) -> Touch:
    """Return a touch as a sensor with another gel sees it."""
    return dataclasses.replace(touch, geometry=dataclasses.replace(touch.geometry, gel=gel))


if __name__ == "__main__":
    main()
