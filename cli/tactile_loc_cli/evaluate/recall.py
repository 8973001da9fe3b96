"""The evaluation of what `run` answers: simulated or own touches of the whole object, refined."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.runtime.errors import ConfigError, TouchError
from tactile_loc_cli import options
from tactile_loc_cli.console import format_count, say, say_reasons
from tactile_loc_cli.evaluate.jobs import Asked, Job, list_jobs, read_setting, say_results, summarise_results
from tactile_loc_cli.options import RunOptions

if TYPE_CHECKING:
    from tactile_loc.evaluation.recall.examples import ExampleSource
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.evaluation.table import EvaluatedRun, ExampleTable
    from tactile_loc.locate.localizer import Localizer

log = logging.getLogger(__name__)

DEFAULT_COUNT, DEFAULT_TOGETHER, DEFAULT_NOISES = 20, (1, 2, 3), ("none", "strong")


def evaluate_answers(given: RunOptions, asked: Asked) -> dict[str, Any]:
    """Evaluate each object with each encoder, noise and seed; write, show and return the results.

    Raises TouchError if every example was refused.
    """
    if asked.touches:
        runs, about = _evaluate_own(given, asked, asked.touches)
    else:
        runs, about = _evaluate_simulated(given, asked)
    return _report(runs, about, asked)


def _evaluate_simulated(given: RunOptions, asked: Asked) -> tuple[list[EvaluatedRun], dict[str, Any]]:
    """Return the results of simulated touches, and what was simulated."""
    from tactile_loc.evaluation.recall.examples import DrawnExamples

    count, together = asked.count or DEFAULT_COUNT, asked.numbers or DEFAULT_TOGETHER
    sources = list(_list_sources(given, asked))
    jobs = list_jobs(given, asked, sources[0])
    runs = []
    for job in jobs:
        localizer = options.open_localizer(job[0], asked.store, job[1])
        for source in sources:
            examples = DrawnExamples(localizer, source, count, together[-1])
            runs.append(_evaluate(job, localizer, examples, together))
    noises = list(dict.fromkeys(source.noise for source in sources))
    return runs, {"examples": count, "noises": noises, "seeds": list(asked.seeds)}


def _list_sources(given: RunOptions, asked: Asked) -> Iterator[SimulatedTouches]:
    """Yield the simulated touches for each noise and seed."""
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches

    in_file = read_setting(given.config, "touch", "noise")
    for noise in asked.noises or ((in_file,) if in_file else DEFAULT_NOISES):
        for seed in asked.seeds:
            yield SimulatedTouches(str(noise), seed)


def _evaluate_own(
    given: RunOptions, asked: Asked, touches: Sequence[Path]
) -> tuple[list[EvaluatedRun], dict[str, Any]]:
    """Return the results of the user's own touches, and where they come from.

    Raises ConfigError unless their object is given, and only one object.
    """
    from tactile_loc.evaluation.recall.examples import LabelledExamples
    from tactile_loc.evaluation.table import MOST_FUSED

    numbers, jobs = asked.numbers, list_jobs(given, asked, None)
    options.require_object(jobs[0][0], f"--touches {touches[0]}")
    if len({obj.name for _, obj in jobs}) > 1:
        raise ConfigError(f"--touches {touches[0]} are of one object; give one --object")
    runs = []
    for job in jobs:
        localizer = options.open_localizer(job[0], asked.store, job[1])
        examples = LabelledExamples.read(localizer, touches)
        together = numbers or tuple(range(1, min(examples.most, MOST_FUSED) + 1))
        examples.require_touches(together)
        runs.append(_evaluate(job, localizer, examples, together))
    if doubt := examples.find_doubt():
        log.warning(doubt)
    return runs, {"examples": examples.count, "touches": [str(path) for path in touches]}


def _evaluate(job: Job, localizer: Localizer, examples: ExampleSource, together: Sequence[int]) -> EvaluatedRun:
    from tactile_loc.evaluation.recall.evaluation import evaluate_recall
    from tactile_loc.evaluation.table import EvaluatedRun

    return EvaluatedRun(evaluate_recall(localizer, examples, together), job[0].resolve())


def _require_located(table: ExampleTable) -> None:
    """Raise TouchError with the first reason if every example was refused."""
    from tactile_loc.evaluation.recall.tables import list_problems
    from tactile_loc.evaluation.table import LABELS
    from tactile_loc.locate.result.verdict import REFUSED

    if (table["verdict"] == REFUSED).all():
        refused = format_count(len(table.group(*LABELS[:-1])), "example")
        raise TouchError(f"no example can be located ({refused} refused); first reason: {list_problems(table)[0][0]}")


def _report(runs: Sequence[EvaluatedRun], about: dict[str, Any], asked: Asked) -> dict[str, Any]:
    """Write the results, print the tables, and return the results as JSON values."""
    from tactile_loc.evaluation.recall.tables import collect_answers
    from tactile_loc.evaluation.table import join_runs

    table, heading = join_runs(runs), _write_heading(about)
    _require_located(table)
    found = collect_answers(runs, about, heading)
    written = found.write(asked.out)
    say_results(found, left=2, name_encoders=False)
    _say_left_out(table)
    return summarise_results(found, written)


def _write_heading(about: dict[str, Any]) -> str:
    from tactile_loc.evaluation.recall.tables import name_noise

    if "touches" in about:
        return f"Localisation of the whole object: {format_count(about['examples'], 'example')} of your own touches"
    kind, seeds = ", ".join(map(name_noise, about["noises"])), ", ".join(map(str, about["seeds"]))
    return (
        f"Localisation of the whole object: {format_count(about['examples'], 'simulated example')} for each object "
        f"({kind}), seed {seeds}"
    )


def _say_left_out(table: ExampleTable) -> None:
    """Report how many presses made no touch, and why examples have no pose."""
    from tactile_loc.evaluation.recall.tables import list_problems

    if refused := table.count_refused():
        say(f"{format_count(refused, 'press')} without a usable touch, replaced by other presses")
    if others := say_reasons(list_problems(table)):
        say(f"and {format_count(others, 'other reason')}, in recall.md")
