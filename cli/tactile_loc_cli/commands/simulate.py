"""`tactile-loc simulate`: simulate touches with known poses."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.core.runtime.errors import ConfigError, OutputError
from tactile_loc.store.files import require_writable, write_atomically, write_json
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, say
from tactile_loc_cli.options import RunOptions, declare

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
    from tactile_loc.core.sensing.touch import Touch
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.sensors.optics.lamps import Optics

logger = logging.getLogger(__name__)

DEFAULT_OUT, LIST = Path("tactile-loc-touches"), "touches.toml"
COUNT, MOST = 10, 100_000  # default and largest numbers of touches
BATCH = 16  # images rendered at a time

Lamps = Annotated[
    str | None,
    declare(
        "--optics NAME",
        "Lights and gel of the images: gelslim, gelsight-mini or digit. Default: those of the sensor if it is one of "
        "these, else gelslim. Implies --images.",
    ),
]
RecordingFile = Annotated[
    Path | None,
    declare(
        "--recording FILE.mcap",
        "Write a ROS recording of a slide over the object instead of single touches: --count images, TF, and the true "
        "poses. The images are depths in metres; with --images, photos.",
    ),
]
Count = Annotated[int | None, declare("--count N", "Number of touches. Default: 10.", min=1, max=MOST)]
Together = Annotated[
    int | None,
    declare(
        "--together N",
        "Simulate N touches of one object at rest instead, and also write touches.toml: a list of the touches with "
        "their sensor poses.",
        min=1,
        max=MOST,
    ),
]
Opposed = Annotated[
    bool,
    declare("--opposed", "With --together: pairs of touches by the two fingers of a gripper, which face each other."),
]
Images = Annotated[bool, declare("--images", "Also write camera images: NAME.png for each touch, and background.png.")]
Out = Annotated[Path, declare("--out FOLDER", "Folder of the touches, poses.json and touches.png.")]
Given = Annotated[
    RunOptions,
    options.Takes(
        *options.OBJECT,
        "press_depth",
        "noise",
        "sensor",
        "grid",
        "renderer",
        *options.SETTINGS,
        "seed",
        press_depth="Depth of the simulated presses in mm. Default: the sensor's maximal depth.",
    ),
]


def simulate(
    given: Given,
    count: Count = None,
    together: Together = None,
    opposed: Opposed = False,
    images: Images = False,
    optics: Lamps = None,
    recording: RecordingFile = None,
    out: Out = DEFAULT_OUT,
) -> dict[str, Any]:
    """Simulate touches with known poses.

    The poses are drawn at random from the grid's range. `run --touch` reads the written contact shapes (npz), and a
    list of touches (touches.toml).
    """
    from tactile_loc.sensors.optics.lamps import choose_optics

    _require_one_kind(count, together, opposed, recording)
    settings = options.make_config(given)
    seen_by = choose_optics(settings.sensor.name, optics) if images or optics is not None else None
    if recording is not None and out != DEFAULT_OUT:
        raise ConfigError("--recording writes a single file; leave out --out")
    require_writable(out if recording is None else recording.parent)
    localizer = options.open_localizer(settings, None)
    if recording is not None:
        return _write_recording(recording, localizer, count or COUNT, seen_by)
    drawn = settings.seed, settings.touch.press_depth_m, settings.touch.noise
    if together is None:
        touches = localizer.simulate(count or COUNT, *drawn)
    else:
        touches = localizer.simulate_together(together, *drawn, opposed)
    record = _write(localizer, touches, out)
    if seen_by is not None:
        _write_images(touches, localizer.scene.geometry, seen_by, settings.seed, out)
    written = (
        "poses.json and touches.png" if seen_by is None else "their images, background.png, poses.json, touches.png"
    )
    if together is not None:
        written = f"{LIST}, {written}"
    say(f"written: {format_count(len(touches), 'touch')}, {written} in {out}")
    names = [touch.name for touch in touches]
    _warn_of_others(out, names, together is not None)
    pictures = [] if seen_by is None else [str(out / f"{name}.png") for name in names]
    return {"folder": str(out), "touches": [str(out / f"{name}.npz") for name in names], "images": pictures, **record}


def _require_one_kind(count: int | None, together: int | None, opposed: bool, recording: Path | None) -> None:
    """Raise ConfigError for options that do not go together."""
    if opposed and together is None:
        raise ConfigError("--opposed needs the number of touches; give --together 2")
    if together is not None and count is not None:
        raise ConfigError("--together gives the number of touches; leave out --count")
    if together is not None and recording is not None:
        raise ConfigError("--recording writes a slide over the object; leave out --together")


def _write_recording(path: Path, localizer: Localizer, images: int, optics: Optics | None) -> dict[str, Any]:
    """Write a slide over the object as a recording."""
    from tactile_loc.core.sensing.noise import make_noise
    from tactile_loc.evaluation import slides

    options.require_mcap("--recording", path)
    config = localizer.config
    slide = slides.draw_random_slide(localizer, images, config.seed, make_noise(config.touch.noise))
    show = slides.show_depths if optics is None else slides.Photos(localizer.scene.geometry, optics, config.seed)
    slides.write_slide(path, slide, show)
    topics = {"image_topic": slides.IMAGE_TOPIC, "truth_topic": slides.TRUTH_TOPIC}
    say(
        "written: {} images on {image_topic}, TF, and true poses on {truth_topic}, in {}".format(images, path, **topics)
    )
    return {"recording": str(path), "images": images, **topics}


def _write(localizer: Localizer, touches: list[Touch], out: Path) -> dict[str, Any]:
    """Write the touches, their poses and their picture; return the contents of poses.json."""
    from tactile_loc.io.touch_lists import write_touch_list
    from tactile_loc.io.touches import OVERVIEW, TRUE_POSES, write_touch
    from tactile_loc.locate.touch_files import name_listed_sensor
    from tactile_loc.view.pictures import draw_touches, save_figure

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({error.strerror}); choose another --out") from error
    for touch in touches:
        write_touch(out / f"{touch.name}.npz", touch)
    press_m = {touch.press_depth_m for touch in touches}  # each touch file has its own press depth
    record = {
        "object": localizer.object.name,
        "press_depth_m": press_m.pop() if len(press_m) == 1 else None,
        "noise": localizer.config.touch.noise,
        "configuration": localizer.config.resolve(),
        "T_sensor_object": {t.name: t.T_sensor_object.tolist() for t in touches if t.T_sensor_object is not None},
    }
    if rest := _describe_rest(touches):
        placed = {f"{t.name}.npz": t.T_base_sensor for t in touches if t.T_base_sensor is not None}
        write_touch_list(out / LIST, placed, name_listed_sensor(localizer.config.sensor, out))
    write_json(out / TRUE_POSES, record | rest)
    name, sensor, noise = localizer.object.name, localizer.config.sensor.name, localizer.config.touch.noise
    title = f"{name} on {sensor}, simulated" + (f" with {noise} noise" if noise != "none" else "")
    save_figure(out / OVERVIEW, draw_touches(touches, title))
    return record | rest


def _describe_rest(touches: list[Touch]) -> dict[str, Any]:
    """Return the poses, in the base frame, of an object at rest and of the sensors that touch it, as JSON values.

    Nothing is returned if the touches have no sensor poses.
    """
    first, sensors = touches[0], {t.name: t.T_base_sensor.tolist() for t in touches if t.T_base_sensor is not None}
    if first.T_base_sensor is None or first.T_sensor_object is None:
        return {}
    return {"T_base_object": (first.T_base_sensor @ first.T_sensor_object).tolist(), "T_base_sensor": sensors}


def _warn_of_others(out: Path, names: list[str], listed: bool) -> None:
    """Warn about older touches in the folder, and about an older list of them."""
    from tactile_loc.io.touches import list_touches

    if not listed and (out / LIST).exists():
        logger.warning("%s is older than the touches, and does not fit them; remove it", out / LIST)
    others = [path.name for path in list_touches(out, "*.npz") if path.stem not in names]
    if others:
        logger.warning(
            "%s also holds %s of an older simulation, such as %s, without a pose in poses.json; remove these files, "
            "or choose another --out",
            out,
            format_count(len(others), "touch"),
            others[0],
        )


def _write_images(touches: list[Touch], geometry: SensorGeometry, optics: Optics, seed: int, out: Path) -> None:
    import numpy as np

    from tactile_loc.sensors.optics.shading import render_background
    from tactile_loc.sensors.optics.simulate import render_touches

    _write_png(out / "background.png", render_background(geometry, optics))
    rng = np.random.default_rng(seed)
    for start in range(0, len(touches), BATCH):
        batch = touches[start : start + BATCH]
        depth_m = np.stack([touch.contact_shape.depth_m for touch in batch])
        press_m = np.array([touch.press_depth_m for touch in batch])
        for touch, image in zip(batch, render_touches(depth_m, press_m, geometry, optics, rng), strict=True):
            _write_png(out / f"{touch.name}.png", image)


def _write_png(path: Path, image: NDArray[Any]) -> None:
    from tactile_loc.io.images import write_image

    write_atomically(path, lambda temporary: write_image(temporary, image))
