"""`tactile-loc run`: where is the object, given one touch?"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc_cli import flags
from tactile_loc_cli.console import say

if TYPE_CHECKING:
    from tactile_loc.core import sensing
    from tactile_loc.core.interfaces import Prior
    from tactile_loc.io.config import RunConfig
    from tactile_loc.locate.localizer import Localizer, Observation
    from tactile_loc.locate.result import Localization

DEFAULT_OUT = Path("tactile-loc-result")
DRAWN = 8  # touches are simulated, and the one with the most contact is shown

Touch = Annotated[
    str | None,
    typer.Option(
        "--touch",
        metavar="FILE|FOLDER|LIST",
        help="The touch: a contact shape (npz, npy, 16-bit png), an image; a folder or '*.png' for many, each for "
        "itself; a list (.toml) for several of one object, fused; by default simulated.",
    ),
]
TouchUnit = Annotated[
    flags.TouchUnit | None,
    typer.Option("--touch-unit", help="Unit of the touch's depths, if its file does not say."),
]
PriorFile = Annotated[
    Path | None, typer.Option("--prior", metavar="FILE", help="What is known of the pose before: a TOML file.")
]
Top = Annotated[int | None, typer.Option("--top", metavar="N", help="How many poses to list; by default 10.")]
Out = Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Where result.json, .npz and .png go.")]


Pictures = Annotated[
    bool, typer.Option("--pictures", help="With a folder of touches: draw result.png for each of them, too.")
]
Report = Annotated[
    bool, typer.Option("--report", help="Write report.html, too: the result as one page to look at and to pass on.")
]


def run(
    object: flags.Object = None,
    units: flags.MeshUnits = None,
    symmetry: flags.Symmetry = None,
    touch: Touch = None,
    touch_unit: TouchUnit = None,
    press_depth: flags.PressDepth = None,
    noise: flags.TouchNoise = None,
    sensor: flags.Sensor = None,
    grid: flags.Grid = None,
    renderer: flags.Renderer = None,
    encoder: flags.Encoder = None,
    matcher: flags.Matcher = None,
    refiner: flags.Refiner = None,
    fuser: flags.Fuser = None,
    option: flags.SetOption = None,
    config: flags.Config = None,
    prior: PriorFile = None,
    top: Top = None,
    seed: flags.Seed = None,
    out: Out = DEFAULT_OUT,
    pictures: Pictures = False,
    report: Report = False,
    store: flags.Store = None,
) -> dict[str, Any]:
    """Locate an object from one touch, from several at once, or from each of a folder's touches.

    Without any options: a demo object and a simulated touch (of eight, the one with the most contact). The object's
    model is built the first time and kept.
    """
    asked = dict(locals())
    from tactile_loc.store.files import require_writable

    settings = flags.run_config(asked)
    _require_one_source(settings, noise)
    require_writable(out)
    localizer = flags.open_localizer(settings, store)
    from tactile_loc_cli.commands.run_folder import is_many, run_folder

    if settings.touch.path is not None and is_many(Path(settings.touch.path)):
        _require_no_prior(prior)
        _require_no_report(report)
        return run_folder(localizer, Path(settings.touch.path), flags.press_depth_m(settings), out, pictures)
    from tactile_loc.locate.localizer import localize_together

    contacts = _contacts(localizer)
    known = _prior(localizer, contacts[0][1], prior)
    start = time.perf_counter()
    for one, touch_of_it in contacts:
        one.localize(touch_of_it, top=2)  # builds, loads and compiles what it takes, once: no part of a touch's time
    seconds = {"model": time.perf_counter() - start}
    alone = len(contacts) == 1
    localization = localizer.localize(contacts[0][1], known) if alone else localize_together(contacts, known)
    return _report(contacts, localization, seconds, out, report)


def _require_one_source(settings: RunConfig, noise: flags.Noise | None) -> None:
    """Refuse noise for a touch that is read from a file: only simulated ones get it."""
    from tactile_loc.core.errors import ConfigError

    if settings.touch.path is not None and (noise is not None or settings.touch.noise != "none"):
        raise ConfigError(
            f"--noise is for simulated touches, but {settings.touch.path} is a touch to be read; leave one of them out"
        )


def _require_no_prior(prior: Path | None) -> None:
    from tactile_loc.core.errors import ConfigError

    if prior is not None:
        raise ConfigError("--prior is of one pose; leave it out with a folder of touches")


def _require_no_report(report: bool) -> None:
    from tactile_loc.core.errors import ConfigError

    if report:
        raise ConfigError("--report is of one result; leave it out with a folder of touches, or locate one of them")


def _prior(localizer: Localizer, touch: sensing.Touch, path: Path | None) -> Prior | None:
    """The prior in the first touch's sensor frame."""
    from tactile_loc.io.prior_files import read_prior

    return None if path is None else read_prior(path, localizer.object).seen_from(touch.T_base_sensor)


def _contacts(localizer: Localizer) -> list[Observation]:
    """The touches that were asked for, each with its localizer."""
    from tactile_loc_cli.commands.run_list import is_list, read_contacts

    path = localizer.config.touch.path
    if path is not None and is_list(Path(path)):
        return read_contacts(localizer, Path(path))
    return [(localizer, _touch(localizer))]


def _touch(localizer: Localizer) -> sensing.Touch:
    """The touch that was asked for, or a simulated one."""
    asked, press_m = localizer.config.touch, flags.press_depth_m(localizer.config)
    if asked.path is not None:
        return localizer.read_touch(asked.path, asked.unit, press_m)
    touches = localizer.simulate(DRAWN, localizer.config.seed, press_m, asked.noise)
    return max(touches, key=lambda t: t.contact_shape.contact.sum())


def _report(
    contacts: list[Observation], localization: Localization, seconds: dict[str, float], out: Path, page: bool
) -> dict[str, Any]:
    """Show the result, write it (result.json, .npz, .png and, if asked for, the page), and return it and the paths."""
    from tactile_loc.drawing.pictures import draw_result, save_figure
    from tactile_loc.locate.result_files import NAME, gather, write_arrays
    from tactile_loc.locate.result_json import pose_errors_m, result_record, write_result
    from tactile_loc_cli.tables import pose_table, summary, title

    localizer = contacts[0][0]
    record = result_record(localizer, localization, seconds)
    pose_table(record)
    for line in summary(record):
        say(line)
    figure = draw_result(localization, localizer.scene, title(record), pose_errors_m(localizer.object, localization))
    written = [
        write_result(out / "result.json", record),
        write_arrays(out / NAME, gather(contacts, localization), record),
        save_figure(out / "result.png", figure),
    ]
    if page:
        from tactile_loc.reports import find_source, write_report

        written.append(write_report(find_source(out / "result.json")))
    say(f"written: {', '.join(map(str, written))}")
    return {**record.model_dump(mode="json"), "written": [str(path) for path in written]}
