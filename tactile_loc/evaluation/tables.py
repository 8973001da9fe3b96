"""Tables of evaluations: Markdown and CSV in mm, and JSON in SI units with every touch's errors."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation import tabular
from tactile_loc.evaluation.metrics import LEVELS, POSTERIOR_METRICS, PosteriorSummary
from tactile_loc.evaluation.protocol import LINES, METRICS, PROTOCOL_VERSION, STAGES, Evaluation

SCHEMA_VERSION = 2
SHOWN = tuple(line for line in LINES if line != "random-10")  # the lines in the summary
JUDGED = ("best-1", "reg-1", "chosen")  # tabulated separately for unambiguous touches
AREAS = (0.0, 0.01, 0.02, 0.05, 0.15, 1.0)  # limits of contact areas, as shares of the observed pixels
AREA_LINE, WITHIN_M = "chosen", 1e-3  # the line and the limit of error that are tabulated by contact area
AREA_NOTE = (
    "By contact area, the share of the sensor in contact: the median ADD of `chosen` in mm, the share of touches "
    "within 1 mm, and in brackets the number of touches. Refused presses show no touch: less contact than the grid "
    "needs, or only a flat face. They do not count elsewhere:"
)
AMBIGUITY_NOTE = (
    "A touch is ambiguous if a pose more than 5 mm away makes the same contact, within the noise (that of the touches, "
    "or mild for clean ones). Median ADD in mm over all touches, and over the unambiguous ones, which are the measure "
    "of a method:"
)
COVERAGE_NOTE = (
    "Coverage: the share of true poses in the smallest sets of poses that hold 50, 80 and 95 % of the probability. "
    "NLL: the mean negative log-likelihood of the grid pose nearest to the truth, beside that of a uniform posterior. "
    "Expected error and spread: the mean distance of the posterior's poses from the truth and from its most probable "
    "pose:"
)


@dataclass(frozen=True, eq=False)
class Run(tabular.EvaluatedObject):
    """One object evaluated with one encoder, from one touch."""

    evaluation: Evaluation

    def summarise_unambiguous(self, line: str) -> tabular.Statistics | None:
        """Return a line's statistics over the unambiguous touches, metres; None if all touches are ambiguous."""
        errors = self.evaluation.select_errors(line)[~self.evaluation.ambiguous]
        return tabular.Statistics.of(errors) if len(errors) else None

    def summarise_posteriors(self) -> PosteriorSummary:
        """Return a summary of the posteriors' metrics."""
        return PosteriorSummary.of(self.evaluation.posterior_metrics, self.grid_poses)

    def compute_median_seconds(self) -> dict[str, float]:
        """Return the median duration of each stage, seconds."""
        return {stage: float(np.median(self.evaluation.select_seconds(stage))) for stage in STAGES}


def tabulate_medians(runs: Sequence[Run], normalised: bool = False) -> tabular.Table:
    """Return a row for each run: the median ADD of each line, in mm or, if `normalised`, as a share.

    A share is the ADD divided by the mean ADD of a random pose.
    """
    write = "{:.3f}".format if normalised else format_mm
    return tabular.tabulate(
        runs, SHOWN, lambda run: (write(run.summarise(line, normalised=normalised).median) for line in SHOWN)
    )


def tabulate_ambiguity(runs: Sequence[Run]) -> tabular.Table:
    """Return a row for each run: the share of ambiguous touches, and median errors in mm.

    The medians are over all touches, and over the unambiguous touches.
    """

    def list_cells(run: Run) -> Iterator[str]:
        yield f"{100 * run.evaluation.ambiguous.mean():.0f} %"
        for line in JUDGED:
            others = run.summarise_unambiguous(line)
            yield from (format_mm(run.summarise(line).median), format_mm(others.median) if others else "-")

    heads = ["ambiguous", *(f"{line}, {of}" for line in JUDGED for of in ("all", "unambiguous"))]
    return tabular.tabulate(runs, heads, list_cells)


def tabulate_areas(runs: Sequence[Run]) -> tabular.Table:
    """Return a row for each run: the number of refused presses, and a cell for each contact area.

    A cell has the median error in mm, the share of touches within WITHIN_M, and in brackets the number of touches.
    """

    def list_cells(run: Run) -> Iterator[str]:
        yield str(run.evaluation.refused.sum())
        for area in _group_areas(run):
            count = area["touches"]
            yield f"{format_mm(area['median_m'])}, {100 * area['within_1_mm']:.0f} % ({count})" if count else "-"

    limits = [f"{100 * share:g}" for share in AREAS]
    between = [f"{low} to {high} %" for low, high in itertools.pairwise(limits[1:-1])]
    return tabular.tabulate(runs, ["refused", f"below {limits[1]} %", *between, f"above {limits[-2]} %"], list_cells)


def tabulate_posteriors(runs: Sequence[Run]) -> tabular.Table:
    """Return a row for each run: the coverage of the credible sets of LEVELS, and mean metrics, lengths in mm."""

    def list_cells(run: Run) -> Iterator[str]:
        summary = run.summarise_posteriors()
        yield from (f"{100 * share:.0f} %" for share in summary.coverage)
        yield from (f"{value:.2f}" for value in (summary.nll, summary.uniform_nll, summary.entropy))
        yield from (format_mm(summary.expected_error_m), format_mm(summary.spread_m))

    sets = (f"in the {100 * level:.0f} % set" for level in LEVELS)
    return tabular.tabulate(
        runs, [*sets, "NLL, nats", "uniform", "entropy", "expected error, mm", "spread, mm"], list_cells
    )


def format_markdown(runs: Sequence[Run], heading: str) -> str:
    """Return all tables as Markdown, lengths in mm."""
    note = (
        "Median ADD in mm and, in brackets, divided by the mean error of a random pose. Symmetric poses count as equal."
    )
    medians = tabular.bracket_shares(tabulate_medians(runs), tabulate_medians(runs, normalised=True), names=2)
    times = tabular.tabulate(
        runs, STAGES, lambda run: (f"{1e3 * s:.1f}" for s in run.compute_median_seconds().values())
    )
    parts = [f"# {heading}\n", f"{note}\n", tabular.format_markdown(medians)]
    parts += [f"{AMBIGUITY_NOTE}\n", tabular.format_markdown(tabulate_ambiguity(runs))]
    parts += [f"{AREA_NOTE}\n", tabular.format_markdown(tabulate_areas(runs))]
    parts += [f"Median time of each stage, ms:\n\n{tabular.format_markdown(times)}"]
    parts += [f"{COVERAGE_NOTE}\n", tabular.format_markdown(tabulate_posteriors(runs))]
    for run in runs:
        about = f"{run.grid_poses} grid poses, symmetry {run.symmetry}; ADD, mm:"
        parts.append(f"## {run.object}, {run.encoder}\n\n{about}\n")
        parts.append(tabular.format_markdown([_DETAILS, *_list_details(run)]))
    return "\n".join(parts)


def format_csv(runs: Sequence[Run]) -> str:
    """Return one row for each object, encoder, line and metric as CSV, lengths in mm."""
    return tabular.format_csv([
        {
            "object": run.object, "encoder": run.encoder, "line": line, "metric": metric,
            **tabular.list_columns(**run.compare_statistics(line, metric)),
        }
        for run in runs for line in LINES for metric in METRICS
    ])  # fmt: skip


def record_runs(runs: Sequence[Run], protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return all results as JSON values in SI units; `protocol` states the number of touches, noise and seed."""
    asked = {"version": PROTOCOL_VERSION, **protocol}
    return tabular.build_document(SCHEMA_VERSION, asked, [_record_run(run) for run in runs])


def write_tables(folder: Path, runs: Sequence[Run], protocol: Mapping[str, Any], heading: str) -> list[Path]:
    """Write results.json, results.csv and results.md and return their paths. Raises OutputError."""
    document = tabular.format_json(record_runs(runs, protocol))
    return tabular.write_texts(
        folder, "results", json=document, csv=format_csv(runs), md=format_markdown(runs, heading)
    )


def _record_run(run: Run) -> dict[str, Any]:
    evaluation = run.evaluation
    unambiguous = {line: found and asdict(found) for line in JUDGED for found in [run.summarise_unambiguous(line)]}
    return run.describe(
        touches=len(evaluation.errors_m),
        random_mean_m={metric: evaluation.compute_scale_m(metric) for metric in METRICS},
        median_seconds=run.compute_median_seconds(),
        lines={line: {metric: run.record_statistics(line, metric) for metric in METRICS} for line in LINES},
        ambiguity={"ambiguous": float(evaluation.ambiguous.mean()), "unambiguous": unambiguous},
        ambiguity_ratios=[r if np.isfinite(r) else None for r in evaluation.ambiguity.tolist()],
        refused=int(evaluation.refused.sum()),
        contact_areas=_group_areas(run),
        contact_shares=evaluation.contact_share.tolist(),
        posterior={**asdict(run.summarise_posteriors()), "levels": list(LEVELS)},
        posterior_metrics=dict(zip(POSTERIOR_METRICS, evaluation.posterior_metrics.T.tolist(), strict=True)),
        errors_m={line: {m: evaluation.select_errors(line, m).tolist() for m in METRICS} for line in LINES},
    )


def _group_areas(run: Run) -> list[dict[str, Any]]:
    """Return, for each of AREAS, the number of touches and the errors of AREA_LINE, metres, None without touches."""
    errors, share = run.evaluation.select_errors(AREA_LINE), run.evaluation.contact_share
    found = []
    for low, high in itertools.pairwise(AREAS):
        some = errors[(share >= low) & ((share < high) | (high == AREAS[-1]))]
        within = float((some < WITHIN_M).mean()) if len(some) else None
        median_m = float(np.median(some)) if len(some) else None
        found.append({"from": low, "to": high, "touches": len(some), "median_m": median_m, "within_1_mm": within})
    return found


_DETAILS = [
    "line", "median", "mean", "std", "quartiles", "90 %", "median / random", "mean / random", "median MSSD",
    "median ADD-S",
]  # fmt: skip


def _list_details(run: Run) -> Iterator[list[str]]:
    for line in LINES:
        s, share = run.compare_statistics(line).values()
        lengths = [*tabular.format_lengths(s), format_mm(s.p90)]
        others = [format_mm(run.summarise(line, metric).median) for metric in ("mssd", "add-s")]
        yield [line, *lengths, f"{share.median:.3f}", f"{share.mean:.3f}", *others]
