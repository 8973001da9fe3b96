"""`tactile-loc evaluate`: measure the accuracy of localisation with the paper's protocol."""

from __future__ import annotations

import dataclasses
import enum
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.slots.registry import SLOTS, registry
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, say, say_table, say_written
from tactile_loc_cli.options import RunOptions

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.evaluation.fusion_tables import FusionRun
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.evaluation.tables import Run
    from tactile_loc.io.config import RunConfig

DEFAULT_OUT = Path("evaluation")
DEFAULT_NOISE = "strong"
DEFAULT_COUNT, CONTACT_COUNT = 150, 100
# Keys of the files whose lists have an item for each touch.
OF_EACH_TOUCH = ("errors_m", "posterior_metrics", "ambiguity_ratios", "contact_shares")

_PART = re.compile(r"(\d+)(?:\.\.(\d+))?")

Objects = Annotated[
    list[str] | None,
    options.declare("--object", "FILE|DEMO", "Mesh file or demo object; may be repeated. Default: all demo objects."),
]
Encoders = Annotated[
    list[str] | None, options.declare("--encoder", "NAME", "Encoder; may be repeated. Default: pixel.")
]
Count = Annotated[
    int | None,
    options.declare(
        "--count", "N",
        "Number of simulated touches for each object. Default: 150. With --contacts: of examples. Default: 100.",
        min=1, max=100_000,
    ),
]  # fmt: skip
Contacts = Annotated[
    str | None,
    options.declare(
        "--contacts", "RANGE",
        "Locate from several touches together, for each of these numbers of touches: 1..7, or 1,2,3 (at most 20).",
    ),
]  # fmt: skip
TouchKind = enum.StrEnum("TouchKind", "SHAPES IMAGES")
Touches = Annotated[
    TouchKind,
    typer.Option(
        "--touches", help="Contact shapes, or images of them for a sensor that was calibrated on simulated images."
    ),
]
TouchNoise = Annotated[
    options.Noise | None,
    typer.Option("--noise", help="Noise of the contact shapes. Default: strong. Images have their own noise."),
]
Grid = Annotated[str | None, options.declare("--grid", "NAME", "Grid that lists its poses. Default: face.")]
Seed = Annotated[int, options.declare("--seed", "N", "Seed of the touches and the random poses.", min=0)]
Out = Annotated[Path, options.declare("--out", "FOLDER", "Folder of results.json, .csv, .md and the pictures.")]
Given = Annotated[
    RunOptions,
    options.Takes("units", "symmetry", "sensor", "renderer", "matcher", "refiner", "fuser", "option", "config"),
]


def evaluate(
    object: Objects = None,
    *,
    given: Given,
    count: Count = None,
    contacts: Contacts = None,
    touches: Touches = TouchKind.SHAPES,
    noise: TouchNoise = None,
    grid: Grid = None,
    encoder: Encoders = None,
    seed: Seed = 0,
    out: Out = DEFAULT_OUT,
    store: options.Store = None,
) -> dict[str, Any]:
    """Measure the accuracy of localisation.

    Each object is located from simulated touches with each encoder, by the protocol in docs/evaluation.md. Errors are
    surface distances. With several encoders, an option goes to the encoders that have it. With --contacts, each example
    has several touches, and the files are contacts.json, .csv, .md and .png. After an interruption, the same command
    resumes.
    """
    from tactile_loc.io.config import LISTED

    numbers = None if contacts is None else parse_contacts(contacts)
    if not _read_setting(given.config, "grid", "name"):
        grid = grid or LISTED.name  # the protocol ranks all poses of the grid
    given = dataclasses.replace(given, noise=noise, grid=grid)
    source = _choose_touches(given, touches, seed)
    jobs = _list_jobs(given, object, encoder, source)
    require_writable(out)
    default = DEFAULT_COUNT if numbers is None else CONTACT_COUNT
    plan = _Plan(count or default, source, out, store)
    if numbers is not None:
        return _evaluate_fusion(jobs, numbers, plan)
    return _report(plan, [plan.work(settings, obj) for settings, obj in jobs])


@dataclass(frozen=True)
class _Plan:
    """The settings of the evaluation of each object and encoder."""

    count: int
    touches: SimulatedTouches
    out: Path
    store: Path | None

    def work(self, settings: RunConfig, obj: ObjectModel) -> Run:
        """Evaluate an object with an encoder, draw its gallery, and return the results."""
        from tactile_loc.drawing.pictures import save_figure
        from tactile_loc.evaluation.figures import draw_gallery
        from tactile_loc.evaluation.protocol import evaluate as run_protocol
        from tactile_loc.evaluation.tables import Run

        localizer = options.open_localizer(settings, self.store, obj)
        encoder = settings.encoder.name
        evaluation = run_protocol(localizer, self.count, self.touches)
        title = f"{obj.name} with {encoder}: best, median and worst of {self.describe('touch')}"
        figure = draw_gallery(localizer, evaluation, self.touches, title)
        save_figure(self.out / _name_gallery(obj.name, encoder), figure)
        poses = len(localizer.model.grid)
        return Run(obj.name, str(obj.symmetry), encoder, poses, evaluation, settings.resolve())

    def describe(self, noun: str) -> str:
        """Return the number and kind of the touches or examples, in words."""
        return f"{format_count(self.count, f'simulated {noun}')} ({self.touches.describe_kind()})"


def _list_jobs(
    given: RunOptions, objects: Objects, encoders: Encoders, touches: SimulatedTouches
) -> list[tuple[RunConfig, ObjectModel]]:
    """Return every object with every encoder. Bad input raises its error here, before the first evaluation."""
    from tactile_loc.io.config import parse_overrides, parse_settings
    from tactile_loc.io.meshes import load_object

    in_file = _read_setting(given.config, "object", "path")
    paths = objects or ([in_file] if in_file else list(DEMO_OBJECTS))
    if given.symmetry is not None and len(paths) > 1:
        raise ConfigError("--symmetry needs a single object; give one --object")
    words = list(given.option or [])
    names: list[str | None] = [*encoders] if encoders else [None]
    overrides = parse_overrides(parse_settings(words)[1]).get("encoder", {})
    given = dataclasses.replace(given, noise=options.Noise(touches.noise))
    jobs = []
    for path in dict.fromkeys(paths):
        asked = [
            dataclasses.replace(given, object=path, encoder=name, option=_choose_options(name, names, words, overrides))
            for name in dict.fromkeys(names)
        ]
        settings = [options.make_config(one) for one in asked]
        chosen = settings[0].object
        obj = load_object(chosen.path, chosen.units, chosen.symmetry)
        for setting in settings:
            touches.require_readable(options.open_localizer(setting, None, obj))
            jobs.append((setting, obj))
    _require_names(jobs)
    return jobs


def _choose_touches(given: RunOptions, kind: TouchKind, seed: int) -> SimulatedTouches:
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches

    images = kind is TouchKind.IMAGES
    default = "none" if images else DEFAULT_NOISE
    noise = given.noise or _read_setting(given.config, "touch", "noise") or default
    return SimulatedTouches(str(noise), seed, images)


def _choose_options(
    encoder: str | None, encoders: Sequence[str | None], words: list[str], overrides: dict[str, Any]
) -> list[str]:
    """Return the options for one of several encoders, without the options that only other encoders have."""
    if encoder is None or len(set(encoders)) == 1 or not overrides:
        return words
    known = {name: set(registry().load("encoder", str(name)).Options.model_fields) for name in encoders}
    foreign = {
        option for option in overrides if option not in known[encoder] and any(option in k for k in known.values())
    }
    return [word for word in words if not any(word.replace(" ", "").startswith(f"encoder.{o}=") for o in foreign)]


def _read_setting(path: Path | None, table: str, key: str) -> str | None:
    """Return a text from a table of the configuration file, or None if it is missing.

    If a slot is only a component's name instead of a table, return this name.
    """
    from tactile_loc.io.toml import read_toml

    found = {} if path is None else read_toml(path).get(table, {})
    value = found.get(key) if isinstance(found, dict) else found if table in SLOTS else None
    return value if isinstance(value, str) else None


def _require_names(jobs: Sequence[tuple[RunConfig, ObjectModel]]) -> None:
    """Raise ConfigError if two objects have the same name."""
    found: dict[str, str] = {}
    for settings, obj in jobs:
        other = found.setdefault(obj.name, settings.object.path)
        if other != settings.object.path:
            raise ConfigError(
                f"{other} and {settings.object.path} are both called {obj.name}; rename one, or run them separately"
            )


def _name_gallery(name: str, encoder: str) -> str:
    return f"gallery-{name}-{encoder}.png"


def _report(plan: _Plan, runs: Sequence[Run]) -> dict[str, Any]:
    from tactile_loc.drawing.pictures import save_figure
    from tactile_loc.evaluation.figures import draw_reliability, draw_violins
    from tactile_loc.evaluation.tables import (
        record_runs,
        tabulate_ambiguity,
        tabulate_areas,
        tabulate_medians,
        tabulate_posteriors,
        write_tables,
    )

    heading = f"Localisation from one touch: {plan.describe('touch')} for each object, seed {plan.touches.seed}"
    protocol = {"touches": plan.count, **dataclasses.asdict(plan.touches)}
    written = write_tables(plan.out, runs, protocol, heading)
    written.append(save_figure(plan.out / "violins.png", draw_violins(runs, heading)))
    written.append(save_figure(plan.out / "reliability.png", draw_reliability(runs, heading)))
    written += [plan.out / _name_gallery(run.object, run.encoder) for run in runs]
    for title, table in (
        ("median ADD, mm", tabulate_medians(runs)),
        ("median ADD divided by the mean ADD of random poses", tabulate_medians(runs, normalised=True)),
        (
            "share of ambiguous touches; median ADD of all touches and of the unambiguous ones, mm",
            tabulate_ambiguity(runs),
        ),
        (
            "by contact area, % of the sensor: median ADD of chosen, mm, share within 1 mm, (number of touches)",
            tabulate_areas(runs),
        ),
        (
            "coverage: share of true poses in the credible sets; means of likelihood, entropy and expected error",
            tabulate_posteriors(runs),
        ),
    ):
        say(title)
        say_table(table)
        say()
    return _summarise(record_runs(runs, protocol), written)


def _summarise(document: dict[str, Any], written: Sequence[Path]) -> dict[str, Any]:
    """Print the paths of the files. Return an evaluation's document with these paths, without each touch's numbers."""
    return {**_drop_touches(document), "written": say_written(written)}


def _drop_touches(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _drop_touches(item) for key, item in value.items() if key not in OF_EACH_TOUCH}
    return [_drop_touches(item) for item in value] if isinstance(value, list) else value


def parse_contacts(text: str) -> tuple[int, ...]:
    """Return the numbers of contacts in a text such as "1..7" or "1,2,5..7", in ascending order.

    Raises ConfigError if the text cannot be read.
    """
    from tactile_loc.evaluation.fusion import MOST_FUSED

    numbers: set[int] = set()
    for part in text.replace(" ", "").split(","):
        match = _PART.fullmatch(part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= first <= last <= MOST_FUSED:
            raise ConfigError(
                f"--contacts cannot be {text!r}; give a range or a list of numbers from 1 to {MOST_FUSED}, "
                "such as 1..7 or 1,2,3"
            )
        numbers.update(range(first, last + 1))
    return tuple(sorted(numbers))


def _evaluate_fusion(
    jobs: Sequence[tuple[RunConfig, ObjectModel]], contacts: Sequence[int], plan: _Plan
) -> dict[str, Any]:
    """Evaluate each object with each encoder and each number of contacts; write, show and return the results."""
    from tactile_loc.evaluation.fusion import evaluate_fusion
    from tactile_loc.evaluation.fusion_tables import FusionRun

    runs = []
    for config, obj in jobs:
        localizer = options.open_localizer(config, plan.store, obj)
        evaluation = evaluate_fusion(localizer, contacts, plan.count, plan.touches)
        about = obj.name, str(obj.symmetry), config.encoder.name, len(localizer.model.grid)
        runs.append(FusionRun(*about, evaluation, config.resolve()))
    return _report_fusion(runs, plan)


def _report_fusion(runs: Sequence[FusionRun], plan: _Plan) -> dict[str, Any]:
    from tactile_loc.drawing.pictures import save_figure
    from tactile_loc.evaluation.figures import draw_fusion
    from tactile_loc.evaluation.fusion_tables import record_runs, tabulate_medians, write_fusion_tables

    heading = (
        f"Localisation from several contacts: {plan.describe('example')} for each object, seed {plan.touches.seed}"
    )
    protocol = {"examples": plan.count, **dataclasses.asdict(plan.touches)}
    written = write_fusion_tables(plan.out, runs, protocol, heading)
    written.append(save_figure(plan.out / "contacts.png", draw_fusion(runs, heading)))
    for title, (header, *rows) in (
        ("median ADD by number of contacts, mm", tabulate_medians(runs)),
        ("median ADD divided by the mean ADD of random poses", tabulate_medians(runs, normalised=True)),
    ):
        say(title)
        say_table([[head.split()[0] for head in header], *rows], left=3)
        say()
    for run in runs:
        _say_left_out(run)
    return _summarise(record_runs(runs, protocol), written)


def _say_left_out(run: FusionRun) -> None:
    """Report how many examples have no pose that touches all sensors, and how many presses showed no touch."""
    found = run.evaluation
    counts = {n: found.count_without_common("best-1", n) for n in found.contacts}
    if any(counts.values()):
        listed = ", ".join(f"{count} with {n}" for n, count in counts.items() if count)
        say(
            f"{run.object}: no pose touches all sensors in some examples, which are located from the first contact "
            f"alone: {listed} contacts\n"
        )
    if found.refused.any():
        say(f"{run.object}: {found.refused.sum()} presses made no contact and were replaced by others\n")
