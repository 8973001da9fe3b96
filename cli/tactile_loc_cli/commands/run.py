"""`tactile-loc run`: locate an object from one touch or several."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.core.runtime.errors import ConfigError, TouchError
from tactile_loc.core.runtime.lazy import import_ahead
from tactile_loc.store.files import lock_folder, require_writable, write_json
from tactile_loc_cli import options
from tactile_loc_cli.commands.build import build_model
from tactile_loc_cli.console import format_count, list_verdicts, make_progress, say, say_written
from tactile_loc_cli.failures import NOT_AS_REQUIRED, Finding
from tactile_loc_cli.options import RunOptions, declare

if TYPE_CHECKING:
    from tactile_loc.core.sensing.scene import Scene
    from tactile_loc.core.sensing.touch import Touch
    from tactile_loc.io.config import RunConfig
    from tactile_loc.io.prior_files import FramedPrior
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.locate.result.localization import Localization
    from tactile_loc.locate.touch_files import LocatedFile

logger = logging.getLogger(__name__)

DEFAULT_OUT = Path("tactile-loc-result")
MOST_SHOWN = 60  # touches of a folder whose contact shapes a report shows
NONE_RIGHT = 0.5  # probability of all listed poses together, below which a warning follows
TOGETHER = 3  # number of simulated touches

Given = Annotated[
    RunOptions,
    options.Takes(
        object="Mesh file (STL, OBJ, PLY, STEP, ...) or demo object. Default: hook, if no touch is given.",
        press_depth="Press depth of the touch in mm. Default: that in its file, or an estimate; simulated touches have "
        "the maximal depth.",
    ),
]
PriorFile = Annotated[
    Path | None,
    Path | None,
    declare("--prior FILE.toml", "Prior knowledge of the pose: a TOML file in mm and degrees (docs/files.md)."),
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of result.json, .npz and .png.")]
Pictures = Annotated[bool, declare("--pictures", "With a folder of touches: also draw a result.png for each.")]


def run(
    given: Given,
    prior: PriorFile = None,
    out: Out = DEFAULT_OUT,
    pictures: Pictures = False,
    report: options.Report = False,
    require: options.Require = None,
    rerun: options.Rerun = None,
    store: options.Store = None,
) -> dict[str, Any]:
    """Locate an object from one touch or several.

    The touches of a list are used together. The touches of a folder are located one by one. Without --touch, the object
    is located from three simulated touches together. The output also states what the first touch alone shows. The
    object's model is built once and stored.
    """
    from tactile_loc.locate.touch_files import is_folder

    settings = options.make_config(given)
    if settings.touch.path is not None:
        options.require_object(settings, f"--touch {settings.touch.path}")
    _require_one_source(settings, given.noise)
    _require_several(settings)
    require_writable(out)
    options.require_rerun(rerun)
    localizer = options.open_localizer(settings, store)
    if settings.touch.path is not None and is_folder(Path(settings.touch.path)):
        _require_none(prior, rerun)
        result = _locate_each(localizer, Path(settings.touch.path), out, pictures, report)
        verdicts = [touch["verdict"] for touch in result["touches"]]
    else:
        result = _locate_together(localizer, prior, out, report, rerun)
        verdicts = [result["verdict"]]
    if require is not None and any(verdict != require for verdict in verdicts):
        raise Finding(NOT_AS_REQUIRED, result)
    return result


def _locate_together(
    localizer: Localizer, prior: Path | None, out: Path, page: bool, rerun: Path | None
) -> dict[str, Any]:
    """Locate the object from one touch or from a list of touches; show, write and return the result."""
    from tactile_loc.io.prior_files import read_prior
    from tactile_loc.locate.several_touches import localize_together

    observations = _read_observations(localizer)
    simulated = localizer.config.touch.path is None
    drawing = import_ahead(*([] if simulated else ["matplotlib.backends.backend_agg", "matplotlib.figure"]))
    framed = None if prior is None else read_prior(prior, localizer.object)
    known = None if framed is None else framed.view_from(observations[0][1].T_base_sensor)
    start = time.perf_counter()
    for one, touch in observations:
        build_model(one, touch.press_depth_m)
    seconds = {"model": time.perf_counter() - start}
    alone = localize_together(observations[:1], known) if simulated else None
    localization = localize_together(observations, known)
    first = next(one for one, touch in observations if localization.touch.is_reading_of(touch))
    drawing.join()
    result = _report(first, localization, seconds, out, page, rerun, alone)
    return result if framed is None else {**result, **_rank_listed(framed, localization)}


def _rank_listed(prior: FramedPrior, found: Localization) -> dict[str, Any]:
    """Show which of the poses that a prior lists are right, and return it; nothing for other priors."""
    import numpy as np

    from tactile_loc.core.poses.priors import HypothesesPrior
    from tactile_loc_cli.results import say_ranks

    if not isinstance(prior.prior, HypothesesPrior):
        return {}
    poses = [h.T_sensor_object if prior.frame == "sensor" else h.T_base_object for h in found.hypotheses]
    after = prior.prior.rank(np.array(poses), np.array([h.probability for h in found.hypotheses]))
    say_ranks(prior.prior.probabilities, after)
    if after.sum() < NONE_RIGHT:
        logger.warning("the touches agree with none of the poses in %s; check its frame and its unit", prior.source)
    pairs = zip(prior.prior.probabilities.tolist(), after.tolist(), strict=True)
    return {"listed_poses": [{"before": before, "after": later} for before, later in pairs]}


def _require_one_source(settings: RunConfig, noise: options.Noise | None) -> None:
    """Raise ConfigError if noise is given together with a touch from a file."""
    if settings.touch.path is not None and (noise is not None or settings.touch.noise != "none"):
        raise ConfigError(f"--noise needs a simulated touch; leave it out, or leave out --touch {settings.touch.path}")


def _require_several(settings: RunConfig) -> None:
    """Raise ConfigError if --drop-outliers is given without a list of touches."""
    from tactile_loc.locate.touch_files import is_list

    path = settings.touch.path
    if settings.drop_outliers and (path is None or not is_list(Path(path))):
        raise ConfigError(
            "--drop-outliers (drop_outliers in a configuration) needs several touches of one object; give a list "
            "(.toml) as --touch, or leave it out"
        )


def _require_none(prior: Path | None, rerun: Path | None) -> None:
    """Raise ConfigError if an option that needs a single result is given with a folder of touches."""
    for given, flag in ((prior, "--prior"), (rerun, "--rerun")):
        if given:
            raise ConfigError(f"{flag} needs a single result; leave it out with a folder of touches, or give one touch")


def _read_observations(localizer: Localizer) -> list[tuple[Localizer, Touch]]:
    """Return the given touches, or simulated touches of the object at rest, each with its localizer."""
    asked = localizer.config.touch
    if asked.path is not None:
        return options.read_touches(localizer, Path(asked.path))
    return [(localizer, touch) for touch in _simulate(localizer)]


def _simulate(localizer: Localizer) -> list[Touch]:
    """Simulate touches of the object at rest, independently of the renderer that locates them."""
    from tactile_loc.io.config import EXACT
    from tactile_loc.locate.localizer import Localizer

    config = localizer.config.model_copy(update={"renderer": EXACT})
    drawing, asked = Localizer(config, localizer.object, localizer.store), config.touch
    return drawing.simulate_together(TOGETHER, config.seed, asked.press_depth_m, asked.noise)


def _report(
    localizer: Localizer,
    localization: Localization,
    seconds: dict[str, float],
    out: Path,
    page: bool,
    rerun: Path | None,
    alone: Localization | None,
) -> dict[str, Any]:
    """Write the files of the result, and then show it. Return the result with the paths of the files.

    The `localizer` is that of the first located touch. `alone` is the result of the first simulated touch alone. The
    files come first, because the reader of the output may close it early.
    """
    from tactile_loc.locate.result.doubts import list_doubts
    from tactile_loc.planning.next_step import suggest_next_step
    from tactile_loc_cli.results import say_alone, say_result

    assessed = replace(localization.assessment, next_step=suggest_next_step(localization))
    localization = replace(localization, assessed=assessed, seconds={**seconds, **localization.seconds})
    written = _write_result(localization, localizer.scene, out, page, alone)
    if rerun is not None:
        from tactile_loc.view.rerun_log import write_localization

        written.append(write_localization(rerun, localization, localizer.scene))
    say_result(localization)
    if alone is not None:
        say_alone(alone, localizer.object)
    for sentence in list_doubts(localization):
        logger.warning("%s", sentence)
    if localization.outliers:
        logger.warning("to leave out the touches that contradict the others, give --drop-outliers")
    return {**localization.to_json(), "written": say_written(written)}


def _write_result(
    localization: Localization, scene: Scene, out: Path, page: bool, alone: Localization | None
) -> list[Path]:
    """Write the files and the picture of a result and, with `page`, its report. Return their paths."""
    with lock_folder(out):
        written = [*localization.save(out, locked=True), _draw(localization, scene, out / "result.png", alone)]
        if page:
            from tactile_loc.reports.report import DEFAULT_NAME, write_page
            from tactile_loc.reports.run import make_result_page

            written.append(write_page(make_result_page(localization.reduce()), out / DEFAULT_NAME))
    return written


def _draw(localization: Localization, scene: Scene, path: Path, alone: Localization | None = None) -> Path:
    """Write the picture of a result, and return its path."""
    from tactile_loc.view.one_versus_several import draw_one_versus_several, save_picture
    from tactile_loc.view.pictures import draw_result, save_figure
    from tactile_loc_cli.results import make_title

    if alone is not None:
        return save_picture(path, draw_one_versus_several(alone, localization, make_title(localization)))
    errors_m = localization.measure_errors_m(scene.object)
    return save_figure(path, draw_result(localization, scene, make_title(localization), errors_m))


def _locate_each(localizer: Localizer, folder: Path, out: Path, pictures: bool, page: bool) -> dict[str, Any]:
    """Locate each touch of a folder or pattern. The table states the reason for a touch that cannot be located.

    Writes results.csv, and a folder for each touch with result.json and, with `pictures`, result.png. With `page`,
    writes report.html. Returns the result of each touch, and the paths. Raises TouchError if the folder has no touch,
    or no touch can be located.
    """
    from tactile_loc.locate.result.doubts import list_doubts
    from tactile_loc.locate.result.located_frame import count_frames
    from tactile_loc.locate.touch_files import find_touches, localize_files, name_folders, write_table
    from tactile_loc_cli.results import say_located

    files = find_touches(folder)
    folders = {path: out / name for path, name in name_folders(files).items()}
    found: list[LocatedFile] = []
    doubtful: list[str] = []
    shown: dict[str, Touch] = {}
    with make_progress().task(f"locating the touches of {folder}", len(files)) as advance:
        for one, localization in localize_files(localizer, files, localizer.config.touch.press_depth_m):
            if localization is not None:
                _write(localizer, localization, folders[one.path], pictures)
                doubtful += [one.name] if list_doubts(localization) else []
                shown |= {one.name: localization.touch} if page and len(shown) < MOST_SHOWN else {}
            found.append(one)
            advance(1)
    written = [write_table(out / "results.csv", found)]
    if page:
        written.append(_write_folder_page(out, localizer, folder, found, shown))
    problems = [one.problem for one in found if one.best is None]
    counts = count_frames(one.verdict for one in found)
    say_located(found)
    count = format_count(len(found), "touch")
    say(f"{count}: {list_verdicts(counts)}; written: {', '.join(map(str, written))}, and a folder for each located one")
    for problem in problems:
        logger.warning("%s", problem)
    _warn_of_doubtful(doubtful)
    if len(problems) == len(found):
        raise TouchError(f"no touch of {folder} can be located; first reason: {problems[0]}")
    return {
        "located": counts["located"],
        "touches": [_make_json(one, folders[one.path]) for one in found],
        "written": [str(path) for path in written],
    }


def _write_folder_page(
    out: Path, localizer: Localizer, folder: Path, found: list[LocatedFile], shown: dict[str, Touch]
) -> Path:
    """Write the page of a folder's touches, with the contact shapes of the `shown` touches, and return its path."""
    from tactile_loc.reports.report import DEFAULT_NAME, write_page
    from tactile_loc.reports.tasks import make_folder_page

    about = f"{localizer.object.name} on {localizer.config.sensor.name}, from {folder}"
    return write_page(make_folder_page(found, shown, about), out / DEFAULT_NAME)


def _warn_of_doubtful(names: list[str]) -> None:
    """Name the touches whose best pose is probably wrong."""
    if names:
        some = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
        count = format_count(len(names), "touch")
        logger.warning("the best pose of %s does not explain it, and is probably wrong: %s", count, some)


def _write(localizer: Localizer, localization: Localization, folder: Path, picture: bool) -> None:
    """Write one touch's result and, with `picture`, its picture."""
    from tactile_loc.locate.result.result_json import NAME

    write_json(folder / NAME, localization.to_json())
    if picture:
        _draw(localization, localizer.scene, folder / "result.png")


def _make_json(located: LocatedFile, folder: Path) -> dict[str, Any]:
    """Return the result of one touch, which is written to `folder`, as JSON values, in SI units."""
    if (best := located.best) is None:
        return {"touch": located.name, "verdict": located.verdict, "error": located.problem}
    return {
        "touch": located.name,
        "result": str(folder / "result.json"),
        "verdict": located.verdict,
        "probability": best.probability,
        "probability_within": located.probability_within,
        "imprint_iou": best.imprint_iou,
        "T_sensor_object": best.T_sensor_object.tolist(),
    }
