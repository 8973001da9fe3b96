"""`tactile-loc paper`: the errors that Bauza et al. (CoRL 2020) report, on a grid that lists its poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.store.files import require_writable, shorten_name
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, say
from tactile_loc_cli.evaluate.jobs import COMPARED, Asked, list_jobs, read_setting, say_results, summarise_results
from tactile_loc_cli.options import RunOptions, declare

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.evaluation.table import EvaluatedRun
    from tactile_loc.evaluation.text_tables import EvaluationResults
    from tactile_loc.locate.localizer import Localizer

DEFAULT_NOISE = "strong"
CONTACTS = range(1, 8)
TOUCHES, EXAMPLES = 150, 100
QUICK_TOUCHES, QUICK_EXAMPLES, QUICK_MM = 40, 40, 4
SPACING = "grid.spacing_mm="

Given = Annotated[
    RunOptions,
    options.Takes("units", "symmetry", "sensor", *COMPARED, *options.SETTINGS, grid="Poses to search. Default: face."),
]
Chosen = Annotated[
    Asked,
    options.Takes(
        "object",
        "count",
        "noise",
        "seed",
        "encoder",
        "store",
        count=f"Number of single touches, and of examples of several contacts. Default: {TOUCHES} and {EXAMPLES}.",
        noise="Noise of the simulated touches. Default: strong.",
        seed="Seed of the simulated touches. Default: 0.",
    ),
]
Quick = Annotated[
    bool,
    declare(
        "--quick",
        f"Take {QUICK_TOUCHES} touches, {QUICK_EXAMPLES} examples of several contacts, and a grid spacing of "
        f"{QUICK_MM} mm, unless --count or -o {SPACING}MM is given.",
    ),
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of the results and pictures.")]


def paper(*, given: Given, asked: Chosen, quick: Quick = False, out: Out = Path("paper")) -> dict[str, Any]:
    """Measure the errors that the paper reports.

    Each object is located from single touches, and from 1 to 7 contacts, by the protocol of Bauza et al. (CoRL 2020).
    The results stand beside the paper's own numbers, where the object resembles one of its objects
    (docs/evaluation.md). After an interruption, the same command resumes.
    """
    from tactile_loc.evaluation.paper.tables import collect_paper

    require_writable(out)
    plan, given = _make_plan(given, asked, quick, out), _choose_grid(given, quick)
    touches, contacts = [], []
    for settings, obj in list_jobs(given, asked, plan.source):
        localizer = options.open_localizer(settings, asked.store, obj)
        touches.append(plan.locate_touches(localizer))
        contacts.append(plan.locate_contacts(localizer))
    protocol = {"touches": plan.touches, "examples": plan.examples, "contacts": list(CONTACTS)}
    about = {**protocol, **dataclasses.asdict(plan.source), "quick": plan.changes}
    quickly = f"--quick: {', '.join(plan.changes)}" if plan.changes else ""
    found = collect_paper(touches, contacts, about, f"The errors that the paper reports{quickly and f' ({quickly})'}")
    written = [*found.write(out), *_report_touches(plan, touches), *_report_contacts(plan, contacts)]
    say_results(found, left=3)
    if quickly:
        say(quickly)
    return summarise_results(found, written)


def choose_touches(given: RunOptions, asked: Asked) -> SimulatedTouches:
    """Return the simulated touches, whose noise the options or the configuration file give.

    Raises ConfigError for several noises or seeds.
    """
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches

    for flag, values in (("--noise", asked.noises), ("--seed", asked.seeds)):
        if len(values) > 1:
            raise ConfigError(f"`tactile-loc paper` takes a single {flag}; give one")
    noise = next(iter(asked.noises), None) or read_setting(given.config, "touch", "noise") or DEFAULT_NOISE
    return SimulatedTouches(str(noise), asked.seeds[0])


def _choose_grid(given: RunOptions, quick: bool) -> RunOptions:
    """Return the options with a grid that lists its poses, since the protocol ranks all of them."""
    from tactile_loc.io.config import LISTED

    if not read_setting(given.config, "grid", "name"):
        given = dataclasses.replace(given, grid=given.grid or LISTED.name)
    words = list(given.option or [])
    return dataclasses.replace(given, option=[f"{SPACING}{QUICK_MM}", *words]) if quick else given


def _make_plan(given: RunOptions, asked: Asked, quick: bool, out: Path) -> _Plan:
    changes = []
    if quick and asked.count is None:
        changes += [f"{QUICK_TOUCHES} touches instead of {TOUCHES}", f"{QUICK_EXAMPLES} examples instead of {EXAMPLES}"]
    if quick and not any(word.replace(" ", "").startswith(SPACING) for word in given.option or []):
        changes.append(f"a grid spacing of {QUICK_MM} mm instead of 3 mm")
    touches, examples = (QUICK_TOUCHES, QUICK_EXAMPLES) if quick else (TOUCHES, EXAMPLES)
    return _Plan(asked.count or touches, asked.count or examples, choose_touches(given, asked), out, changes)


@dataclass(frozen=True)
class _Plan:
    """The measurement of each object and encoder, and the `changes` that --quick made, in words."""

    touches: int
    examples: int
    source: SimulatedTouches
    out: Path
    changes: Sequence[str]

    def locate_touches(self, localizer: Localizer) -> EvaluatedRun:
        """Locate single touches, draw their gallery, and return the results."""
        from tactile_loc.evaluation.protocol import evaluate
        from tactile_loc.evaluation.table import EvaluatedRun
        from tactile_loc.reports.paper_figures import draw_gallery
        from tactile_loc.view.pictures import save_figure

        name, encoder = localizer.object.name, localizer.config.encoder.name
        table = evaluate(localizer, self.touches, self.source)
        title = f"{name} with {encoder}: best, median and worst of {self.describe(self.touches, 'touch')}"
        save_figure(self.out / _name_gallery(name, encoder), draw_gallery(localizer, table, self.source, title))
        return EvaluatedRun(table, localizer.config.resolve())

    def locate_contacts(self, localizer: Localizer) -> EvaluatedRun:
        """Locate the examples of several contacts, and return the results."""
        from tactile_loc.evaluation.paper.fusion import evaluate_fusion
        from tactile_loc.evaluation.table import EvaluatedRun

        table = evaluate_fusion(localizer, CONTACTS, self.examples, self.source)
        return EvaluatedRun(table, localizer.config.resolve())

    def describe(self, count: int, noun: str) -> str:
        """Return the number and kind of the touches or examples, in words."""
        return f"{format_count(count, f'simulated {noun}')} (noise: {self.source.noise})"


def _name_gallery(name: str, encoder: str) -> str:
    return f"gallery-{shorten_name(name)}-{encoder}.png"


def _report_touches(plan: _Plan, runs: Sequence[EvaluatedRun]) -> list[Path]:
    """Write the results from one touch and their pictures, show the medians in mm, and return the paths."""
    from tactile_loc.evaluation.paper.tables import collect_touches
    from tactile_loc.evaluation.table import join_runs
    from tactile_loc.reports.paper_figures import draw_reliability, draw_violins

    counted = plan.describe(plan.touches, "touch")
    heading = f"Localisation from one touch: {counted} for each object, seed {plan.source.seed}"
    table = join_runs(runs)
    found = collect_touches(runs, {"touches": plan.touches, **dataclasses.asdict(plan.source)}, heading)
    figures = {"violins": draw_violins(table, heading), "reliability": draw_reliability(table, heading)}
    say_results(found, left=2)
    galleries = [plan.out / _name_gallery(*names) for names in table.group("object", "encoder")]
    return [*_write_results(plan.out, found, figures), *galleries]


def _report_contacts(plan: _Plan, runs: Sequence[EvaluatedRun]) -> list[Path]:
    """Write the results by number of contacts and their picture, and return the paths."""
    from tactile_loc.evaluation.paper.tables import collect_contacts
    from tactile_loc.evaluation.table import join_runs
    from tactile_loc.reports.paper_figures import draw_contacts

    counted = plan.describe(plan.examples, "example")
    heading = f"Localisation from several contacts: {counted} for each object, seed {plan.source.seed}"
    found = collect_contacts(runs, {"examples": plan.examples, **dataclasses.asdict(plan.source)}, heading)
    _say_left_out(found)
    return _write_results(plan.out, found, {"contacts": draw_contacts(join_runs(runs), heading)})


def _write_results(out: Path, found: EvaluationResults, figures: Mapping[str, Figure]) -> list[Path]:
    """Write the files of an evaluation, and its figures as NAME.png. Return the paths. Raises OutputError."""
    from tactile_loc.view.pictures import save_figure

    return [*found.write(out), *(save_figure(out / f"{name}.png", figure) for name, figure in figures.items())]


def _say_left_out(found: EvaluationResults) -> None:
    """Report how many examples have no pose that touches all sensors, and how many presses showed no touch."""
    for run in found.document["runs"]:
        own = {"object": run["object"], "encoder": run["encoder"], "line": "best-1"}
        rows = [row for row in found.document["summary"] if own.items() <= row.items()]
        if counts := {row["contacts"]: row["without_common"] for row in rows if row["without_common"]}:
            listed = ", ".join(f"{count} with {n}" for n, count in counts.items())
            say(
                f"{run['object']}: no pose touches all sensors in some examples, which are located from the first "
                f"contact alone: {listed} contacts"
            )
        if run["refused"]:
            say(f"{run['object']}: {run['refused']} presses made no contact and were replaced by others")
    say()
