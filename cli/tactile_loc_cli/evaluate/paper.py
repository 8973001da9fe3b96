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
    from tactile_loc.evaluation.fusion_tables import FusionRun
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.evaluation.tables import Run
    from tactile_loc.io.config import RunConfig

DEFAULT_NOISE = "strong"
DEFAULT_COUNT, CONTACT_COUNT = 150, 100
# Keys of the files whose lists have an item for each touch.
OF_EACH_TOUCH = ("errors_m", "posterior_metrics", "ambiguity_ratios", "contact_shares")


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

    def work(self, settings: RunConfig, obj: ObjectModel) -> Run:
        """Evaluate an object with an encoder, draw its gallery, and return the results."""
        from tactile_loc.evaluation.figures import draw_gallery
        from tactile_loc.evaluation.protocol import evaluate as run_protocol
        from tactile_loc.evaluation.tables import Run
        from tactile_loc.view.pictures import save_figure

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


def _name_gallery(name: str, encoder: str) -> str:
    return f"gallery-{shorten_name(name)}-{encoder}.png"


def _report(plan: _Plan, runs: Sequence[Run]) -> dict[str, Any]:
    from tactile_loc.evaluation.figures import draw_reliability, draw_violins
    from tactile_loc.evaluation.tables import (
        record_runs,
        tabulate_ambiguity,
        tabulate_areas,
        tabulate_medians,
        tabulate_posteriors,
        write_tables,
    )
    from tactile_loc.view.pictures import save_figure

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


def _evaluate_fusion(jobs: Sequence[Job], contacts: Sequence[int], plan: _Plan) -> dict[str, Any]:
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
    from tactile_loc.evaluation.figures import draw_fusion
    from tactile_loc.evaluation.fusion_tables import record_runs, tabulate_medians, write_fusion_tables
    from tactile_loc.view.pictures import save_figure

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
            f"alone: {listed} contacts"
        )
        say()
    if found.refused.any():
        say(f"{run.object}: {found.refused.sum()} presses made no contact and were replaced by others")
        say()
