"""`tactile-loc doctor`: check the installation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc_cli.console import say, say_table
from tactile_loc_cli.failures import UNEXPECTED, Finding
from tactile_loc_cli.options import Store, declare

if TYPE_CHECKING:
    from tactile_loc_cli.doctor.checks import Diagnosis


def doctor(
    store: Store = None,
    compiling: Annotated[
        bool, declare("--compile", "Also compile the code for locating, which speeds up the first run.")
    ] = False,
) -> dict[str, Any]:
    """Check the installation.

    Each library is tried in a separate process. If one is missing or broken, its line says what to do. The exit code is
    1 if something required is missing or broken.
    """
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
