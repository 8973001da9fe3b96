"""`tactile-loc mount`: find where the sensor is mounted on the robot's flange."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.console import say_written
from tactile_loc_cli.options import RunOptions, declare

DEFAULT_OUT = Path("tactile-loc-mount")

Touches = Annotated[
    str, declare("--touch LIST", "List (.toml) of ten or more touches of one fixed part, each with its T_base_flange.")
]
Nominal = Annotated[
    Path | None,
    declare(
        "--nominal FILE.toml",
        "Approximate mount: T_flange_sensor, or xyz_mm and rpy_deg; within 30 mm and 30 degrees of the true one.",
    ),
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of mount.toml and mount.png.")]
Given = Annotated[
    RunOptions,
    options.Takes(*options.OBJECT, *options.TOUCH_FILES, "sensor", "zero", *options.SETTINGS, object=options.TOUCHED),
]


def mount(
    touch: Touches, given: Given, nominal: Nominal = None, out: Out = DEFAULT_OUT, store: options.Store = None
) -> dict[str, Any]:
    """Find where a sensor is mounted on a flange.

    Touch a known, fixed part with the flange at known poses that rotate about two or more axes. Touches that contradict
    the others are left out and named. To use the result in a list of touches, write mount = "mount.toml" and give
    T_base_flange for each touch.
    """
    from tactile_loc.io.mount_files import read_mount, write_mount
    from tactile_loc.planning.hand_eye_calibration import calibrate_hand_eye, make_hand_eye_record, read_flange_touches
    from tactile_loc.view.pictures import save_figure
    from tactile_loc.view.tasks import draw_hand_eye
    from tactile_loc_cli.results import say_mount

    settings = options.make_config(replace(given, touch=touch))
    options.require_object(settings, f"--touch {touch}")
    require_writable(out)
    expected = None if nominal is None else read_mount(nominal)
    localizer = options.open_localizer(settings, store)
    found = calibrate_hand_eye(localizer, read_flange_touches(localizer, Path(touch)), expected)
    record = make_hand_eye_record(localizer, found)
    say_mount(record)
    title = f"{record.sensor} on the flange, from touches of {record.object}"
    written = [write_mount(out / "mount.toml", record), save_figure(out / "mount.png", draw_hand_eye(found, title))]
    return {**record.model_dump(mode="json", exclude_none=True), "written": say_written(written)}
