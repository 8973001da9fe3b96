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
from tactile_loc_cli.console import format_count, say, say_table, say_written
from tactile_loc_cli.evaluate.jobs import Asked, Job, list_jobs, read_setting
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
    source = choose_touches(given, asked)
    jobs = list_jobs(given, asked.objects, asked.encoders, source)
    default = DEFAULT_COUNT if asked.together is None else CONTACT_COUNT
    plan = _Plan(asked.count or default, source, asked.out, asked.store)
    if asked.together is not None:
        return _evaluate_fusion(jobs, asked.together, plan)
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
    from tactile_loc.evaluation import paper_tables
    from tactile_loc.evaluation.table import join_runs
    from tactile_loc.reports.evaluation_figures import draw_reliability, draw_violins
    from tactile_loc.view.pictures import save_figure

    heading = f"Localisation from one touch: {plan.describe('touch')} for each object, seed {plan.touches.seed}"
    protocol, table = {"touches": plan.count, **dataclasses.asdict(plan.touches)}, join_runs(runs)
    written = paper_tables.write_touch_tables(plan.out, runs, protocol, heading)
    written.append(save_figure(plan.out / "violins.png", draw_violins(table, heading)))
    written.append(save_figure(plan.out / "reliability.png", draw_reliability(table, heading)))
    written += [plan.out / _name_gallery(*names) for names in table.group("object", "encoder")]
    document = paper_tables.record_touches(runs, protocol)
    lines, rows = document["summary"], document["runs"]
    for title, some in (
        ("median ADD, mm", paper_tables.tabulate_medians(lines, paper_tables.format_median)),
        (
            "median ADD divided by the mean ADD of random poses",
            paper_tables.tabulate_medians(lines, paper_tables.format_share_of_random),
        ),
        (
            "share of ambiguous touches; median ADD of all touches and of the unambiguous ones, mm",
            paper_tables.tabulate_ambiguity(rows, lines),
        ),
        (
            "by contact area, % of the sensor: median ADD of chosen, mm, share within 1 mm, (number of touches)",
            paper_tables.tabulate_areas(rows),
        ),
        (
            "coverage: share of true poses in the credible sets; means of likelihood, entropy and expected error",
            paper_tables.tabulate_posteriors(rows),
        ),
    ):
        say(title)
        say_table(some)
        say()
    return _summarise(document, written)


def _summarise(document: dict[str, Any], written: Sequence[Path]) -> dict[str, Any]:
    """Print the paths of the files. Return an evaluation's document with these paths, without each touch's numbers."""
    del document["examples"]
    return {**document, "written": say_written(written)}


def _evaluate_fusion(jobs: Sequence[Job], contacts: Sequence[int], plan: _Plan) -> dict[str, Any]:
    """Evaluate each object with each encoder and each number of contacts; write, show and return the results."""
    from tactile_loc.evaluation.fusion import evaluate_fusion
    from tactile_loc.evaluation.table import EvaluatedRun

    runs = []
    for config, obj in jobs:
        localizer = options.open_localizer(config, plan.store, obj)
        runs.append(EvaluatedRun(evaluate_fusion(localizer, contacts, plan.count, plan.touches), config.resolve()))
    return _report_fusion(runs, plan)


def _report_fusion(runs: Sequence[EvaluatedRun], plan: _Plan) -> dict[str, Any]:
    from tactile_loc.evaluation import paper_tables
    from tactile_loc.evaluation.fusion import FUSED_LINES
    from tactile_loc.evaluation.table import join_runs
    from tactile_loc.reports.evaluation_figures import draw_contacts
    from tactile_loc.view.pictures import save_figure

    heading = (
        f"Localisation from several contacts: {plan.describe('example')} for each object, seed {plan.touches.seed}"
    )
    protocol = {"examples": plan.count, **dataclasses.asdict(plan.touches)}
    written = paper_tables.write_contact_tables(plan.out, runs, protocol, heading)
    written.append(save_figure(plan.out / "contacts.png", draw_contacts(join_runs(runs), heading)))
    document = paper_tables.record_contacts(runs, protocol)
    fused = [row for row in document["summary"] if row["line"] in FUSED_LINES]
    for title, cell in (
        ("median ADD by number of contacts, mm", paper_tables.format_median),
        ("median ADD divided by the mean ADD of random poses", paper_tables.format_share_of_random),
    ):
        header, *rows = paper_tables.tabulate_contacts(fused, cell)
        say(title)
        say_table([[head.split()[0] for head in header], *rows], left=3)
        say()
    for run in document["runs"]:
        _say_left_out(run, fused)
    return _summarise(document, written)


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
