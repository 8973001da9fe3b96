"""The evaluation with the paper's protocol, on a grid that lists its poses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.store.files import shorten_name
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, say
from tactile_loc_cli.evaluate.jobs import (
    Asked,
    Job,
    list_jobs,
    read_setting,
    say_results,
    summarise_results,
    write_results,
)
from tactile_loc_cli.options import RunOptions

if TYPE_CHECKING:
    from tactile_loc.core.objects.mesh import ObjectModel
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.evaluation.table import EvaluatedRun
    from tactile_loc.io.config import RunConfig

DEFAULT_NOISE = "strong"
DEFAULT_COUNT, CONTACT_COUNT = 150, 100


def evaluate_paper(given: RunOptions, asked: Asked) -> dict[str, Any]:
    """Evaluate each object with each encoder, from single touches or from several; write, show and return the results.

    Raises ConfigError for several noises or seeds.
    """
    from tactile_loc.io.config import LISTED

    for flag, values in (("--noise", asked.noises), ("--seed", asked.seeds)):
        if len(values) > 1:
            raise ConfigError(f"--paper takes a single {flag}; give one, or leave out --paper")
    if not read_setting(given.config, "grid", "name"):
        given = dataclasses.replace(given, grid=given.grid or LISTED.name)  # the protocol ranks all poses of the grid
    source, numbers = choose_touches(given, asked), asked.numbers
    jobs = list_jobs(given, asked, source)
    default = DEFAULT_COUNT if numbers is None else CONTACT_COUNT
    plan = _Plan(asked.count or default, source, asked.out, asked.store)
    if numbers is not None:
        return _evaluate_fusion(jobs, numbers, plan)
    return _report(plan, [plan.work(settings, obj) for settings, obj in jobs])


def choose_touches(given: RunOptions, asked: Asked) -> SimulatedTouches:
    """Return the simulated touches, whose noise the options or the configuration file give."""
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches

    default = "none" if asked.images else DEFAULT_NOISE
    noise = next(iter(asked.noises), None) or read_setting(given.config, "touch", "noise") or default
    return SimulatedTouches(str(noise), asked.seeds[0], asked.images)


@dataclass(frozen=True)
class _Plan:
    """The settings of the evaluation of each object and encoder."""

    count: int
    touches: SimulatedTouches
    out: Path
    store: Path | None

    def work(self, settings: RunConfig, obj: ObjectModel) -> EvaluatedRun:
        """Evaluate an object with an encoder, draw its gallery, and return the results."""
        from tactile_loc.evaluation.protocol import evaluate as run_protocol
        from tactile_loc.evaluation.table import EvaluatedRun
        from tactile_loc.reports.evaluation_figures import draw_gallery
        from tactile_loc.view.pictures import save_figure

        localizer = options.open_localizer(settings, self.store, obj)
        encoder = settings.encoder.name
        table = run_protocol(localizer, self.count, self.touches)
        title = f"{obj.name} with {encoder}: best, median and worst of {self.describe('touch')}"
        save_figure(self.out / _name_gallery(obj.name, encoder), draw_gallery(localizer, table, self.touches, title))
        return EvaluatedRun(table, settings.resolve())

    def describe(self, noun: str) -> str:
        """Return the number and kind of the touches or examples, in words."""
        return f"{format_count(self.count, f'simulated {noun}')} ({self.touches.describe_kind()})"


def _name_gallery(name: str, encoder: str) -> str:
    return f"gallery-{shorten_name(name)}-{encoder}.png"


def _report(plan: _Plan, runs: Sequence[EvaluatedRun]) -> dict[str, Any]:
    from tactile_loc.evaluation.paper_tables import collect_touches
    from tactile_loc.evaluation.table import join_runs
    from tactile_loc.reports.evaluation_figures import draw_reliability, draw_violins

    heading = f"Localisation from one touch: {plan.describe('touch')} for each object, seed {plan.touches.seed}"
    table = join_runs(runs)
    found = collect_touches(runs, {"touches": plan.count, **dataclasses.asdict(plan.touches)}, heading)
    figures = {"violins": draw_violins(table, heading), "reliability": draw_reliability(table, heading)}
    written = write_results(plan.out, found, figures)
    written += [plan.out / _name_gallery(*names) for names in table.group("object", "encoder")]
    say_results(found, left=2)
    return summarise_results(found, written)


def _evaluate_fusion(jobs: Sequence[Job], contacts: Sequence[int], plan: _Plan) -> dict[str, Any]:
    """Evaluate each object with each encoder and each number of contacts; write, show and return the results."""
    from tactile_loc.evaluation.fusion import evaluate_fusion
    from tactile_loc.evaluation.paper_tables import collect_contacts
    from tactile_loc.evaluation.table import EvaluatedRun, join_runs
    from tactile_loc.reports.evaluation_figures import draw_contacts

    runs = []
    for config, obj in jobs:
        localizer = options.open_localizer(config, plan.store, obj)
        runs.append(EvaluatedRun(evaluate_fusion(localizer, contacts, plan.count, plan.touches), config.resolve()))
    heading = (
        f"Localisation from several contacts: {plan.describe('example')} for each object, seed {plan.touches.seed}"
    )
    found = collect_contacts(runs, {"examples": plan.count, **dataclasses.asdict(plan.touches)}, heading)
    written = write_results(plan.out, found, {"contacts": draw_contacts(join_runs(runs), heading)})
    say_results(found, left=3)
    for run in found.document["runs"]:
        _say_left_out(run, found.document["summary"])
    return summarise_results(found, written)


def _say_left_out(run: dict[str, Any], rows: Sequence[dict[str, Any]]) -> None:
    """Report how many examples have no pose that touches all sensors, and how many presses showed no touch."""
    own = {"object": run["object"], "encoder": run["encoder"], "line": "best-1"}
    counts = {row["contacts"]: row["without_common"] for row in rows if own.items() <= row.items()}
    if any(counts.values()):
        listed = ", ".join(f"{count} with {n}" for n, count in counts.items() if count)
        say(
            f"{run['object']}: no pose touches all sensors in some examples, which are located from the first contact "
            f"alone: {listed} contacts"
        )
        say()
    if run["refused"]:
        say(f"{run['object']}: {run['refused']} presses made no contact and were replaced by others")
        say()
