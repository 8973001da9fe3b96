"""`tactile-loc evaluate`: how well objects are located, by the paper's protocol."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc_cli import flags
from tactile_loc_cli.commands import evaluate_contacts as several
from tactile_loc_cli.console import progress, say, say_table

if TYPE_CHECKING:
    from tactile_loc.core.objects import ObjectModel
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.evaluation.tables import Run
    from tactile_loc.io.config import RunConfig
    from tactile_loc.locate.localizer import Localizer

DEFAULT_OUT = Path("evaluation")
DEFAULT_NOISE = "strong"
DEFAULT_COUNT = 150

Objects = Annotated[
    list[str] | None,
    typer.Option(
        "--object", metavar="FILE|DEMO", help="Mesh file or demo object; may be repeated; by default all demo objects."
    ),
]
Encoders = Annotated[
    list[str] | None,
    typer.Option("--encoder", metavar="NAME", help="What makes vectors; may be repeated; by default pixel."),
]
Count = Annotated[
    int | None,
    typer.Option(
        "--count",
        min=1,
        max=100_000,
        metavar="N",
        help="How many simulated touches an object, by default 150; with --contacts how many examples, by default 100.",
    ),
]
Contacts = Annotated[
    str | None,
    typer.Option(
        "--contacts",
        metavar="RANGE",
        help="Locate from several touches at once, of so many: 1..7, or 1,2,3 (1 to 20); beside contact alone.",
    ),
]


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
    flags.Noise | None,
    typer.Option("--noise", help="How far shapes are from clean renders; by default strong. Images have their own."),
]
Seed = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Seed of the touches and the random poses.")]
Out = Annotated[
    Path, typer.Option("--out", metavar="FOLDER", help="Where results.json, .csv, .md and the pictures go.")
]


def evaluate(
    object: Objects = None,
    units: flags.MeshUnits = None,
    symmetry: flags.Symmetry = None,
    count: Count = None,
    contacts: Contacts = None,
    touches: Touches = TouchKind.SHAPES,
    noise: TouchNoise = None,
    sensor: flags.Sensor = None,
    grid: flags.Grid = None,
    renderer: flags.Renderer = None,
    encoder: Encoders = None,
    matcher: flags.Matcher = None,
    refiner: flags.Refiner = None,
    fuser: flags.Fuser = None,
    option: flags.SetOption = None,
    config: flags.Config = None,
    seed: Seed = 0,
    out: Out = DEFAULT_OUT,
    store: flags.Store = None,
) -> dict[str, Any]:
    """Measure how well objects are located.

    Each object is located from simulated touches with each encoder, by the protocol in docs/evaluation.md; errors are
    surface distances. With several encoders, an option of the encoder goes to those that have it. With --contacts each
    example is several touches, and what is written are contacts.json, .csv, .md and .png. Interrupted, the same command
    resumes.
    """
    asked = {key: value for key, value in locals().items() if key not in ("count", "contacts", "seed", "out", "store")}
    from tactile_loc.store.files import require_writable

    numbers = None if contacts is None else several.parse_contacts(contacts)
    jobs, source = _jobs(asked, seed)
    require_writable(out)
    if numbers is not None:
        located = [(settings, _localizer(settings, obj, store)) for settings, obj in jobs]
        return several.evaluate_contacts(located, numbers, count or several.DEFAULT_COUNT, source, out)
    plan = _Plan(count or DEFAULT_COUNT, source, out, store)
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
        from tactile_loc.locate.result_json import resolved

        localizer = _localizer(settings, obj, self.store)
        encoder = settings.encoder.name
        evaluation = run_protocol(localizer, self.count, self.touches)
        title = f"{obj.name} with {encoder}: best, median and worst of {self._asked_about()}"
        figure = draw_gallery(localizer, evaluation, self.touches, title)
        save_figure(self.out / _gallery(obj.name, encoder), figure)
        return Run(
            obj.name,
            str(obj.symmetry),
            encoder,
            len(localizer.model.grid),
            evaluation,
            configuration=resolved(settings),
        )

    def heading(self) -> str:
        """Return the title of tables and pictures."""
        return f"Localisation from one touch: {self._asked_about()} for each object, seed {self.touches.seed}"

    def _asked_about(self) -> str:
        touches = f"{self.count} simulated {'touch' if self.count == 1 else 'touches'}"
        return f"{touches} ({self.touches.in_words()})"


def _jobs(asked: dict[str, Any], seed: int) -> tuple[list[tuple[RunConfig, ObjectModel]], SimulatedTouches]:
    """Every object with every encoder, and the touches; what can be wrong is found before the first is evaluated."""
    from tactile_loc.io.config import parse_overrides

    in_file = _in_file(asked["config"])
    objects = asked["object"] or _named(in_file.get("object"), "path") or _demo_objects()
    encoders = asked["encoder"] or [None]
    if asked["symmetry"] is not None and len(objects) > 1:
        raise _config_error("--symmetry is of one object; give one --object with it")
    overrides = parse_overrides(asked["option"] or []).get("encoder", {})
    touches = _touches(asked, in_file, seed)
    jobs = []
    for path in dict.fromkeys(objects):
        settings = []
        for encoder in dict.fromkeys(encoders):
            options = _options_of(encoder, encoders, asked["option"] or [], overrides)
            one = {**asked, "object": path, "encoder": encoder, "option": options, "noise": touches.noise}
            settings.append(flags.run_config(one))
        obj = flags.load_object(settings[0])
        for setting in settings:
            touches.require_readable(_localizer(setting, obj, None))
            jobs.append((setting, obj))
    _require_names(jobs)
    return jobs, touches


def _touches(asked: dict[str, Any], in_file: dict[str, Any], seed: int) -> SimulatedTouches:
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches

    images = asked["touches"] is TouchKind.IMAGES
    default = "none" if images else DEFAULT_NOISE
    noise = asked["noise"] or (_named(in_file.get("touch"), "noise") or [default])[0]
    return SimulatedTouches(str(noise), seed, images)


def _options_of(
    encoder: str | None, encoders: Sequence[str | None], words: list[str], overrides: dict[str, Any]
) -> list[str]:
    """The options for one of several encoders: without those that only others have."""
    from tactile_loc.core.registry import registry

    if encoder is None or len(set(encoders)) == 1 or not overrides:
        return words
    known = {name: set(registry().load("encoder", str(name)).Options.model_fields) for name in encoders}
    foreign = {
        option for option in overrides if option not in known[encoder] and any(option in k for k in known.values())
    }
    return [word for word in words if not any(word.replace(" ", "").startswith(f"encoder.{o}=") for o in foreign)]


def _in_file(path: Path | None) -> dict[str, Any]:
    from tactile_loc.io.toml import read_toml

    return {} if path is None else read_toml(path)


def _named(table: Any, key: str) -> list[str]:
    """What a configuration file's table says of a key, if it does."""
    return [table[key]] if isinstance(table, dict) and isinstance(table.get(key), str) else []


def _demo_objects() -> list[str]:
    from tactile_loc.data import DEMO_OBJECTS

    return list(DEMO_OBJECTS)


def _require_names(jobs: Sequence[tuple[RunConfig, ObjectModel]]) -> None:
    """Refuse two objects of one name: their results could not be told apart."""
    found: dict[str, str] = {}
    for settings, obj in jobs:
        other = found.setdefault(obj.name, settings.object.path)
        if other != settings.object.path:
            raise _config_error(
                f"{other} and {settings.object.path} are both called {obj.name}; rename one, or evaluate them apart"
            )


def _config_error(text: str) -> Exception:
    from tactile_loc.core.errors import ConfigError

    return ConfigError(text)


def _localizer(settings: RunConfig, obj: ObjectModel, store: Path | None) -> Localizer:
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.store.store import StageStore

    return Localizer(settings, obj, StageStore(store), progress())


def _gallery(name: str, encoder: str) -> str:
    return f"gallery-{name}-{encoder}.png"


def _report(plan: _Plan, runs: Sequence[Run]) -> dict[str, Any]:
    from tactile_loc.drawing.pictures import save_figure
    from tactile_loc.evaluation.figures import draw_reliability, draw_violins
    from tactile_loc.evaluation.tables import (
        medians_mm,
        medians_normalised,
        posterior_header,
        posterior_rows,
        record,
        summary_header,
        write_tables,
    )

    protocol = {"touches": plan.count, **dataclasses.asdict(plan.touches)}
    written = write_tables(plan.out, runs, protocol, plan.heading())
    written.append(save_figure(plan.out / "violins.png", draw_violins(runs, plan.heading())))
    written.append(save_figure(plan.out / "reliability.png", draw_reliability(runs, plan.heading())))
    written += [plan.out / _gallery(run.object, run.encoder) for run in runs]
    say("median ADD, mm")
    say_table([summary_header(), *medians_mm(runs)])
    say("\nmedian ADD as a share of a random pose's mean")
    say_table([summary_header(), *medians_normalised(runs)])
    say("\ncoverage: true poses in the sets that hold so much of the probability, and means")
    say_table([posterior_header(), *posterior_rows(runs)])
    say(f"\nwritten: {', '.join(map(str, written))}")
    return several.summarised(record(runs, protocol), written)
