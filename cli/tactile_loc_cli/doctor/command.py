"""`tactile-loc doctor`: check the installation, or a calibrated sensor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc_cli.console import say, say_table
from tactile_loc_cli.failures import UNEXPECTED, Finding
from tactile_loc_cli.options import Store, declare

if TYPE_CHECKING:
    from tactile_loc_cli.doctor.checks import Diagnosis


Photos = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[PHOTO|FOLDER]...", help="With --sensor: photos of presses of the calibration's ball."),
]
Sensor = Annotated[Path | None, declare("--sensor FOLDER", "Check this calibrated sensor, and not the installation.")]
Zero = Annotated[Path | None, declare("--zero IMAGE", "With --sensor: newer image of the untouched gel.")]
Out = Annotated[Path, declare("--out FOLDER", "With --sensor: folder of the page passport.html.")]


def doctor(
    photos: Photos = None,
    sensor: Sensor = None,
    zero: Zero = None,
    out: Out = Path("tactile-loc-doctor"),
    store: Store = None,
    compiling: Annotated[
        bool, declare("--compile", "Also compile the code for locating, which speeds up the first run.")
    ] = False,
) -> dict[str, Any]:
    """Check the installation, or a calibrated sensor.

    Each library is tried in a separate process. If one is missing or broken, its line says what to do. With --sensor,
    photos of presses show whether the sensor is still as it was when it was calibrated. The exit code is 1 if
    something required is missing or broken, or if the sensor has a fault.
    """
    if sensor is not None:
        from tactile_loc_cli.doctor.passport import check_sensor

        return check_sensor(sensor, photos or [], zero, out, store)
    if photos or zero is not None:
        raise ConfigError("photos and --zero are for checks of a sensor; give --sensor FOLDER, too")
    from tactile_loc_cli.doctor.checks import examine

    checks = examine(store, compiling=compiling)
    _report(checks)
    fatal = [check.name for check in checks if check.is_fatal]
    result = {"ready": not fatal, "broken": fatal, "checks": [check.record() for check in checks]}
    if fatal:
        say()
        say(f"tactile-loc cannot work here: {', '.join(fatal)}")
        raise Finding(UNEXPECTED, result)
    say()
    say("tactile-loc is ready")
    return result


def _report(checks: Sequence[Diagnosis]) -> None:
    rows = [
        [str(check.state), check.name, f"{check.says}; {check.remedy}" if check.remedy else check.says]
        for check in checks
    ]
    say_table(rows, left=3)
