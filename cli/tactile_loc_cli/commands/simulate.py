"""`tactile-loc simulate`: touches whose poses are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile_loc_cli import flags
from tactile_loc_cli.console import say

if TYPE_CHECKING:
    from tactile_loc.core.localizer import Localizer
    from tactile_loc.core.sensing import Touch

DEFAULT_OUT = Path("tactile-loc-touches")


def simulate(
    object: flags.Object = None,
    units: flags.MeshUnits = None,
    symmetry: flags.Symmetry = None,
    count: Annotated[int, typer.Option("--count", min=1, max=100_000, metavar="N", help="How many touches.")] = 10,
    press_depth: flags.PressDepth = None,
    noise: flags.TouchNoise = None,
    sensor: flags.Sensor = None,
    grid: flags.Grid = None,
    renderer: flags.Renderer = None,
    option: flags.SetOption = None,
    config: flags.Config = None,
    seed: flags.Seed = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Where touches, poses.json and touches.png go.")
    ] = DEFAULT_OUT,
) -> None:
    """Simulate touches with known poses.

    Random contact poses of those that the grid covers, as contact shapes (npz) that `run --touch` reads.
    """
    asked = dict(locals())
    from tactile_loc.evaluation.files import require_writable

    settings = flags.run_config(asked)
    require_writable(out)
    localizer = flags.open_localizer(settings, None)
    touches = localizer.simulate(count, settings.seed, flags.press_depth_m(settings), settings.touch.noise)
    _write(localizer, touches, out)
    say(f"written: {len(touches)} touches, poses.json and touches.png in {out}")


def _write(localizer: Localizer, touches: list[Touch], out: Path) -> None:
    from tactile_loc.core.errors import OutputError
    from tactile_loc.core.touches import write_touch
    from tactile_loc.evaluation.files import write_atomically
    from tactile_loc.evaluation.pictures import draw_touches, save_figure
    from tactile_loc.evaluation.results import resolved

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({error.strerror}); choose another --out") from error
    for touch in touches:
        write_touch(out / f"{touch.name}.npz", touch)
    press_m = {touch.press_depth_m for touch in touches}  # each file has its own
    record = {
        "object": localizer.object.name,
        "press_depth_m": press_m.pop() if len(press_m) == 1 else None,
        "noise": localizer.config.touch.noise,
        "configuration": resolved(localizer.config),
        "T_sensor_object": {t.name: t.T_sensor_object.tolist() for t in touches if t.T_sensor_object is not None},
    }
    text = json.dumps(record, indent=1) + "\n"
    write_atomically(out / "poses.json", lambda path: path.write_text(text, encoding="utf-8"))
    name, sensor, noise = localizer.object.name, localizer.config.sensor.name, localizer.config.touch.noise
    title = f"{name} on {sensor}, simulated" + (f" with {noise} noise" if noise != "none" else "")
    save_figure(out / "touches.png", draw_touches(touches, title))
