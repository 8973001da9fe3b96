"""Simulated photos of a tactile sensor: of a pressed ball, to calibrate the sensor, and of an object."""

import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tactile_loc_app.session import LIST, Session

from tactile_loc import Localizer, SensorGeometry, write_sensor_file
from tactile_loc.io.images import encode_png
from tactile_loc.io.touch_lists import write_touch_list
from tactile_loc.sensors.optics.lamps import OPTICS, Optics
from tactile_loc.sensors.optics.shading import render_background, render_images
from tactile_loc.sensors.optics.simulate import press_gel, render_touches

PHOTO_PX, MM_PER_PX, BALL_MM, BALLS = (320, 240), 0.0634, 3.0, 20  # size of photos, scale, radius, and presses
PLACES = (-6e-3, 6e-3), (-4e-3, 4e-3), (3e-4, 1e-3)  # ranges of the presses' x, y and depth, metres
PHOTOS, PART_MM = (3, 4, 5, 6), 0.6  # numbers of photos of the part that are tried, and its press


def choose_camera() -> tuple[SensorGeometry, Optics]:
    """Return the sensor that takes the photos, as its maker knows it, and its lamps."""
    (width, height), per_m = PHOTO_PX, 1e3 / MM_PER_PX
    geometry = SensorGeometry(
        "orthographic", width, height, per_m, per_m, width / 2, height / 2, standoff_m=0.01, max_depth_m=1.5e-3
    )
    return geometry, OPTICS["gelsight-mini"]


def photograph_balls(folder: Path, rng: np.random.Generator) -> tuple[Path, Path]:
    """Write a simulated photo without contact, and an archive of photos of a ball; return both paths."""
    geometry, lamps = choose_camera()
    ball_m = 1e-3 * BALL_MM
    x, y = np.meshgrid(*geometry.pixel_slopes)
    x_m, y_m, press_m = (rng.uniform(low, high, (BALLS, 1, 1)) for low, high in PLACES)
    below_m = ball_m - np.sqrt(np.maximum(ball_m**2 - (x - x_m) ** 2 - (y - y_m) ** 2, 0))
    depth_m = np.minimum(below_m, press_m).astype(np.float32)
    gel = press_gel(depth_m, press_m.ravel(), geometry)
    untouched, photos = folder / "untouched.png", folder / "photos.zip"
    untouched.write_bytes(encode_png(render_background(geometry, lamps)))
    with zipfile.ZipFile(photos, "w") as archive:
        for number, image in enumerate(render_images(gel, geometry, lamps, rng), 1):
            archive.writestr(f"ball-{number:02d}.png", encode_png(image))
    return untouched, photos


def photograph_part(session: Session, path: Path, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Write an archive of `count` simulated photos of the session's object, with their list; return its pose (4, 4).

    The pose is in the base frame, in metres.
    """
    geometry, lamps = choose_camera()
    sensor = path.with_name("camera.toml")
    write_sensor_file(sensor, geometry)
    chosen = session.localizer.config.object
    camera = Localizer.create(
        chosen.path, units=chosen.units, sensor={"name": "file", "path": str(sensor)}, store=session.localizers.store
    )
    touches = camera.simulate_together(count, seed=1, press_depth_m=1e-3 * PART_MM)
    with zipfile.ZipFile(path, "w") as archive:
        for touch in touches:
            depth_m, press_m = touch.contact_shape.depth_m[None], np.array([touch.press_depth_m])
            image = render_touches(depth_m, press_m, geometry, lamps, rng)[0]
            archive.writestr(f"{touch.name}.png", encode_png(image))
        poses = {f"{touch.name}.png": touch.T_base_sensor for touch in touches}
        archive.write(write_touch_list(path.with_name(LIST), poses), LIST)
    return np.asarray(touches[0].T_base_sensor @ touches[0].T_sensor_object)
