"""`tactile-loc evaluate`: how well objects are located, by the paper's protocol."""

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
from tactile_loc_cli.console import say, say_table, say_written
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
# Keys of the files whose lists are as long as there are touches.
OF_EACH_TOUCH = ("errors_m", "posterior_metrics", "ambiguity_ratios", "contact_shares")

_PART = re.compile(r"(\d+)(?:\.\.(\d+))?")

Objects = Annotated[
    list[str] | None,
    options.declare("--object", "FILE|DEMO", "Mesh file or demo object; may be repeated; by default all demo objects."),
]
Encoders = Annotated[
    list[str] | None, options.declare("--encoder", "NAME", "What makes vectors; may be repeated; by default pixel.")
]
Count = Annotated[
    int | None,
    options.declare(
        "--count", "N",
        "How many simulated touches an object, by default 150; with --contacts how many examples, by default 100.",
        min=1, max=100_000,
    ),
]  # fmt: skip
Contacts = Annotated[
    str | None,
    options.declare(
        "--contacts", "RANGE",
        "Locate from several touches at once, of so many: 1..7, or 1,2,3 (1 to 20); beside contact alone.",
    ),
]  # fmt: skip


class TouchKind(enum.StrEnum):
    """What touches are given as."""

    SHAPES = "shapes"
    IMAGES = "images"


Touches = Annotated[
    TouchKind,
    typer.Option(
        "--touches",
        help="Contact shapes, or images of them that the sensor reads: one that was calibrated on simulated ones.",
    ),
]
TouchNoise = Annotated[
    options.Noise | None,
    typer.Option("--noise", help="How far shapes are from clean renders; by default strong. Images have their own."),
]
Grid = Annotated[
    str | None, options.declare("--grid", "NAME", "Which poses are searched, of those that list them; by default face.")
]
Seed = Annotated[int, options.declare("--seed", "N", "Seed of the touches and the random poses.", min=0)]
Out = Annotated[Path, options.declare("--out", "FOLDER", "Where results.json, .csv, .md and the pictures go.")]


Given = Annotated[
    RunOptions,
    options.takes("units", "symmetry", "sensor", "renderer", "matcher", "refiner", "fuser", "option", "config"),
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
    """Measure how well objects are located.

    Each object is located from simulated touches with each encoder, by the protocol in docs/evaluation.md; errors are
    surface distances. With several encoders, an option of the encoder goes to those that have it. With --contacts each
    example is several touches, and what is written are contacts.json, .csv, .md and .png. Interrupted, the same command
    resumes.
    """
    from tactile_loc.io.config import LISTED

    numbers = None if contacts is None else parse_contacts(contacts)
    if not _read_setting(given.config, "grid", "name"):
        grid = grid or LISTED.name  # the protocol compares with all poses
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
    """What is done with each object and encoder."""

    count: int
    touches: SimulatedTouches
    out: Path
    store: Path | None

    def work(self, settings: RunConfig, obj: ObjectModel) -> Run:
        """Evaluate an object with an encoder, draw its gallery, and return what was found."""
        from tactile_loc.drawing.pictures import save_figure
        from tactile_loc.evaluation.figures import draw_gallery
        from tactile_loc.evaluation.protocol import evaluate as run_protocol
        from tactile_loc.evaluation.tables import Run

        localizer = options.open_localizer(settings, self.store, obj)
        encoder = settings.encoder.name
        evaluation = run_protocol(localizer, self.count, self.touches)
        title = f"{obj.name} with {encoder}: best, median and worst of {self._describe()}"
        figure = draw_gallery(localizer, evaluation, self.touches, title)
        save_figure(self.out / _name_gallery(obj.name, encoder), figure)
        poses = len(localizer.model.grid)
        return Run(obj.name, str(obj.symmetry), encoder, poses, evaluation, settings.resolve())

    def make_heading(self) -> str:
        """Return the title of tables and pictures."""
        return f"Localisation from one touch: {self._describe()} for each object, seed {self.touches.seed}"

    def _describe(self) -> str:
        touches = f"{self.count} simulated {'touch' if self.count == 1 else 'touches'}"
        return f"{touches} ({self.touches.in_words()})"


def _list_jobs(
    given: RunOptions, objects: Objects, encoders: Encoders, touches: SimulatedTouches
) -> list[tuple[RunConfig, ObjectModel]]:
    """Every object with every encoder; what can be wrong is found before the first is evaluated."""
    from tactile_loc.io.config import parse_overrides, parse_settings
    from tactile_loc.io.meshes import load_object

    in_file = _read_setting(given.config, "object", "path")
    paths = objects or ([in_file] if in_file else list(DEMO_OBJECTS))
    if given.symmetry is not None and len(paths) > 1:
        raise ConfigError("--symmetry is of one object; give one --object with it")
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
    """The options for one of several encoders: without those that only others have."""
    if encoder is None or len(set(encoders)) == 1 or not overrides:
        return words
    known = {name: set(registry().load("encoder", str(name)).Options.model_fields) for name in encoders}
    foreign = {
        option for option in overrides if option not in known[encoder] and any(option in k for k in known.values())
    }
    return [word for word in words if not any(word.replace(" ", "").startswith(f"encoder.{o}=") for o in foreign)]


def _read_setting(path: Path | None, table: str, key: str) -> str | None:
    """What a configuration file says of a table's key, if it does; a slot may be its component's name alone."""
    from tactile_loc.io.toml import read_toml

    found = {} if path is None else read_toml(path).get(table, {})
    value = found.get(key) if isinstance(found, dict) else found if table in SLOTS else None
    return value if isinstance(value, str) else None


def _require_names(jobs: Sequence[tuple[RunConfig, ObjectModel]]) -> None:
    """Refuse two objects of one name: their results could not be told apart."""
    found: dict[str, str] = {}
    for settings, obj in jobs:
        other = found.setdefault(obj.name, settings.object.path)
        if other != settings.object.path:
            raise ConfigError(
                f"{other} and {settings.object.path} are both called {obj.name}; rename one, or evaluate them apart"
            )


def _name_gallery(name: str, encoder: str) -> str:
    return f"gallery-{name}-{encoder}.png"


def _report(plan: _Plan, runs: Sequence[Run]) -> dict[str, Any]:
    from tactile_loc.drawing.pictures import save_figure
    from tactile_loc.evaluation.figures import draw_reliability, draw_violins
    from tactile_loc.evaluation.tables import (
        ambiguity_header,
        ambiguity_rows,
        area_header,
        area_rows,
        medians_mm,
        medians_normalised,
        posterior_header,
        posterior_rows,
        record,
        summary_header,
        write_tables,
    )

    protocol = {"touches": plan.count, **dataclasses.asdict(plan.touches)}
    written = write_tables(plan.out, runs, protocol, plan.make_heading())
    written.append(save_figure(plan.out / "violins.png", draw_violins(runs, plan.make_heading())))
    written.append(save_figure(plan.out / "reliability.png", draw_reliability(runs, plan.make_heading())))
    written += [plan.out / _name_gallery(run.object, run.encoder) for run in runs]
    say("median ADD, mm")
    say_table([summary_header(), *medians_mm(runs)])
    say("\nmedian ADD as a share of a random pose's mean")
    say_table([summary_header(), *medians_normalised(runs)])
    say("\nambiguous touches, and median ADD over all touches and over those that are not, mm")
    say_table([ambiguity_header(), *ambiguity_rows(runs)])
    say("\nby the share of the sensor in contact: median ADD of chosen, mm, and touches within 1 mm")
    say_table([area_header(), *area_rows(runs)])
    say("\ncoverage: true poses in the sets that hold so much of the probability, and means")
    say_table([posterior_header(), *posterior_rows(runs)])
    say()
    return _summarise(record(runs, protocol), written)


def _summarise(document: dict[str, Any], written: Sequence[Path]) -> dict[str, Any]:
    """An evaluation's document without the numbers of each touch, and with the paths that were written."""
    return {**_drop_touches(document), "written": say_written(written)}


def _drop_touches(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _drop_touches(item) for key, item in value.items() if key not in OF_EACH_TOUCH}
    return [_drop_touches(item) for item in value] if isinstance(value, list) else value


def parse_contacts(text: str) -> tuple[int, ...]:
    """Return the numbers of contacts that a text such as "1..7" or "1,2,5..7" names, rising. Raises ConfigError."""
    from tactile_loc.evaluation.fusion import MOST_FUSED

    numbers: set[int] = set()
    for part in text.replace(" ", "").split(","):
        match = _PART.fullmatch(part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= first <= last <= MOST_FUSED:
            raise ConfigError(
                f"--contacts {text!r} names no numbers of contacts; write a range or a list from 1 to {MOST_FUSED}, "
                "such as 1..7 or 1,2,3"
            )
        numbers.update(range(first, last + 1))
    return tuple(sorted(numbers))


def _evaluate_fusion(
    jobs: Sequence[tuple[RunConfig, ObjectModel]], contacts: Sequence[int], plan: _Plan
) -> dict[str, Any]:
    """Evaluate each object with each encoder and each number of contacts; write, show and return what was found."""
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
    from tactile_loc.evaluation.fusion_tables import median_header, median_rows, record, write_fusion_tables

    examples = f"{plan.count} simulated {'example' if plan.count == 1 else 'examples'} ({plan.touches.in_words()})"
    heading = f"Localisation from several contacts: {examples} for each object, seed {plan.touches.seed}"
    protocol = {"examples": plan.count, **dataclasses.asdict(plan.touches)}
    written = write_fusion_tables(plan.out, runs, protocol, heading)
    written.append(save_figure(plan.out / "contacts.png", draw_fusion(runs, heading)))
    header = [head.split()[0] for head in median_header(runs)]
    say("median ADD by number of contacts, mm")
    say_table([header, *median_rows(runs, normalised=False)], left=3)
    say("\nmedian ADD as a share of a random pose's mean")
    say_table([header, *median_rows(runs, normalised=True)], left=3)
    for run in runs:
        _say_left_out(run)
    say()
    return _summarise(record(runs, protocol), written)


def _say_left_out(run: FusionRun) -> None:
    """Say how often no pose touched all sensors, and how many presses showed no touch, if it happened."""
    found = run.evaluation
    counts = {n: found.without_common("best-1", n) for n in found.contacts}
    if any(counts.values()):
        listed = ", ".join(f"{count} with {n}" for n, count in counts.items() if count)
        say(
            f"\n{run.object}: examples without a pose that touches all sensors, located from the first contact alone: "
            f"{listed} contacts"
        )
    if found.refused.any():
        say(f"\n{run.object}: {found.refused.sum()} presses that showed no touch were refused, and others drawn")
