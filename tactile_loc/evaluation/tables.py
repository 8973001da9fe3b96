"""Evaluations as tables: Markdown and CSV for people, in mm, and JSON in SI units with every touch's errors."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.formatting import mm
from tactile_loc.evaluation import tabular
from tactile_loc.evaluation.posterior_metrics import LEVELS, POSTERIOR_METRICS, PosteriorSummary
from tactile_loc.evaluation.protocol import LINES, METRICS, PROTOCOL_VERSION, STAGES, Evaluation

SCHEMA_VERSION = 2
SHOWN = tuple(line for line in LINES if line != "random-10")  # in the summary
JUDGED = ("best-1", "reg-1", "chosen")  # told apart by whether the touches are ambiguous
AREAS = (0.0, 0.01, 0.02, 0.05, 0.15, 1.0)  # limits of shares of the observed pixels in contact
AREA_LINE, WITHIN_M = "chosen", 1e-3  # what is told by contact area
AREA_NOTE = (
    "By how much of the sensor is in contact: the median ADD of `chosen` in mm, the share of touches within 1 mm, and "
    "in brackets how many touches there are. Refused: presses that showed no touch, since noise left less contact than "
    "the grid asks for, or nothing but a flat face; they count nowhere else:"
)
AMBIGUITY_NOTE = (
    "Ambiguous: touches whose contact a pose more than 5 mm away makes as well, within the noise (that of the touches, "
    "or mild for clean ones). Median ADD in mm over all touches, and over those that are not ambiguous, by which a "
    "method is to be judged:"
)
COVERAGE_NOTE = (
    "Coverage: how many true poses lie in the smallest sets of poses that hold 50, 80 "
    "and 95 % of the probability, the mean negative log-likelihood of the grid pose nearest to the truth beside that "
    "of knowing nothing, the entropy, and how far poses drawn from the posterior are from the truth (expected error) "
    "and from its most probable pose (spread):"
)


@dataclass(frozen=True, eq=False)
class Run(tabular.EvaluatedObject):
    """One object evaluated with one encoder, from one touch."""

    evaluation: Evaluation

    def statistics(self, line: str, metric: str = "add", normalised: bool = False) -> tabular.Statistics:
        """Return the statistics of a line: in metres, or as shares of the mean random error if `normalised`."""
        values = self.evaluation.errors(line, metric)
        return tabular.Statistics.of(values / self.evaluation.scale_m(metric) if normalised else values)

    def unambiguous(self, line: str) -> tabular.Statistics | None:
        """Return a line's statistics over the touches that are not ambiguous, metres; None if all are."""
        errors = self.evaluation.errors(line)[~self.evaluation.ambiguous]
        return tabular.Statistics.of(errors) if len(errors) else None

    def posterior_summary(self) -> PosteriorSummary:
        """Return the metrics of the posteriors, summed up."""
        return PosteriorSummary.of(self.evaluation.posterior_metrics, self.grid_poses)

    def median_seconds(self) -> dict[str, float]:
        """Return the median duration of each stage, seconds."""
        return {stage: float(np.median(self.evaluation.stage_seconds(stage))) for stage in STAGES}


def summary_header() -> list[str]:
    """Return the heads of the columns of `summary_rows`."""
    return ["object", "encoder", *SHOWN]


def summary_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row of cells for each run: the median ADD of each line, "mm (normalised)"."""
    return tabular.bracketed(medians_mm(runs), medians_normalised(runs), names=2)


def medians_mm(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row of cells for each run: object, encoder, the median ADD of each line, mm."""
    return [[run.object, run.encoder, *(mm(run.statistics(line).median) for line in SHOWN)] for run in runs]


def medians_normalised(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row of cells for each run: object, encoder, each line's median ADD as a share of a random pose's."""
    shares = [[run.statistics(line, normalised=True).median for line in SHOWN] for run in runs]
    return [[run.object, run.encoder, *(f"{v:.3f}" for v in row)] for run, row in zip(runs, shares, strict=True)]


def time_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row of cells for each run: the median milliseconds of each stage."""
    return [[run.object, run.encoder, *(f"{1e3 * s:.1f}" for s in run.median_seconds().values())] for run in runs]


def ambiguity_header() -> list[str]:
    """Return the heads of the columns of `ambiguity_rows`."""
    return ["object", "encoder", "ambiguous", *(f"{line}, {of}" for line in JUDGED for of in ("all", "unambiguous"))]


def ambiguity_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row of cells for each run: the share of ambiguous touches, medians over all and over the others, mm."""
    rows = []
    for run in runs:
        row = [run.object, run.encoder, f"{100 * run.evaluation.ambiguous.mean():.0f} %"]
        for line in JUDGED:
            others = run.unambiguous(line)
            row += [mm(run.statistics(line).median), mm(others.median) if others else "-"]
        rows.append(row)
    return rows


def area_header() -> list[str]:
    """Return the heads of the columns of `area_rows`."""
    limits = [f"{100 * share:g}" for share in AREAS]
    between = [f"{low} to {high} %" for low, high in itertools.pairwise(limits[1:-1])]
    return ["object", "encoder", "refused", f"below {limits[1]} %", *between, f"above {limits[-2]} %"]


def area_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row of cells for each run: presses refused, and for each contact area "median mm, share (touches)"."""
    rows = []
    for run in runs:
        cells = []
        for area in _areas(run):
            near = f"{mm(area['median_m'])}, {100 * area['within_1_mm']:.0f} %" if area["touches"] else ""
            cells.append(f"{near} ({area['touches']})" if near else "-")
        rows.append([run.object, run.encoder, str(run.evaluation.refused.sum()), *cells])
    return rows


def posterior_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Return a row of cells for each run: how often each of LEVELS holds, and mean metrics, lengths in mm."""
    rows = []
    for run in runs:
        summary = run.posterior_summary()
        held = [f"{100 * share:.0f} %" for share in summary.coverage]
        nats = [f"{value:.2f}" for value in (summary.nll, summary.uniform_nll, summary.entropy)]
        rows.append([run.object, run.encoder, *held, *nats, mm(summary.expected_error_m), mm(summary.spread_m)])
    return rows


def posterior_header() -> list[str]:
    """Return the heads of the columns of `posterior_rows`."""
    sets = [f"in the {100 * level:.0f} % set" for level in LEVELS]
    return ["object", "encoder", *sets, "NLL, nats", "uniform", "entropy", "expected error, mm", "spread, mm"]


def markdown(runs: Sequence[Run], heading: str) -> str:
    """Return all tables as Markdown, the lengths in mm."""
    note = "Median ADD in mm and, in brackets, divided by the mean error of a random pose; symmetry regarded."
    parts = [f"# {heading}\n", f"{note}\n", tabular.markdown_table(summary_header(), summary_rows(runs))]
    parts += [f"{AMBIGUITY_NOTE}\n", tabular.markdown_table(ambiguity_header(), ambiguity_rows(runs))]
    parts += [f"{AREA_NOTE}\n", tabular.markdown_table(area_header(), area_rows(runs))]
    times = tabular.markdown_table(["object", "encoder", *STAGES], time_rows(runs))
    parts += [f"Median time of each stage, ms:\n\n{times}"]
    parts += [f"{COVERAGE_NOTE}\n", tabular.markdown_table(posterior_header(), posterior_rows(runs))]
    for run in runs:
        parts.append(
            f"## {run.object}, {run.encoder}\n\n{run.grid_poses} grid poses, symmetry {run.symmetry}; ADD, mm:\n"
        )
        parts.append(tabular.markdown_table(_DETAILS, _detail_rows(run)))
    return "\n".join(parts)


def csv_text(runs: Sequence[Run]) -> str:
    """Return one row for each object, encoder, line and metric as CSV, lengths in mm."""
    return tabular.csv_table(list(_long_rows(runs)))


def record(runs: Sequence[Run], protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return everything as JSON values in SI units; `protocol` says how many touches, which noise and seed."""
    return tabular.document(
        SCHEMA_VERSION, {"version": PROTOCOL_VERSION, **protocol}, [_run_record(run) for run in runs]
    )


def write_tables(folder: Path, runs: Sequence[Run], protocol: Mapping[str, Any], heading: str) -> list[Path]:
    """Write results.json, results.csv and results.md and return their paths. Raises OutputError."""
    return tabular.write_all(folder, "results", record(runs, protocol), csv_text(runs), markdown(runs, heading))


def _run_record(run: Run) -> dict[str, Any]:
    evaluation = run.evaluation
    return run.record(
        touches=len(evaluation.errors_m),
        random_mean_m={metric: evaluation.scale_m(metric) for metric in METRICS},
        median_seconds=run.median_seconds(),
        lines={line: {metric: _statistics(run, line, metric) for metric in METRICS} for line in LINES},
        ambiguity=_ambiguity(run),
        ambiguity_ratios=[r if np.isfinite(r) else None for r in evaluation.ambiguity.tolist()],
        refused=int(evaluation.refused.sum()),
        contact_areas=_areas(run),
        contact_shares=evaluation.contact_share.tolist(),
        posterior={**asdict(run.posterior_summary()), "levels": list(LEVELS)},
        posterior_metrics=dict(zip(POSTERIOR_METRICS, evaluation.posterior_metrics.T.tolist(), strict=True)),
        errors_m={line: {m: evaluation.errors(line, m).tolist() for m in METRICS} for line in LINES},
    )


def _ambiguity(run: Run) -> dict[str, Any]:
    """The share of ambiguous touches, and each of JUDGED over the others, metres; null where all are ambiguous."""
    others = {line: run.unambiguous(line) for line in JUDGED}
    unambiguous = {line: None if found is None else asdict(found) for line, found in others.items()}
    return {"ambiguous": float(run.evaluation.ambiguous.mean()), "unambiguous": unambiguous}


def _areas(run: Run) -> list[dict[str, Any]]:
    """The touches of each of AREAS, and the errors of AREA_LINE over them, metres; null where there is none."""
    errors, share = run.evaluation.errors(AREA_LINE), run.evaluation.contact_share
    found = []
    for low, high in itertools.pairwise(AREAS):
        some = errors[(share >= low) & ((share < high) | (high == AREAS[-1]))]
        within = float((some < WITHIN_M).mean()) if len(some) else None
        median_m = float(np.median(some)) if len(some) else None
        found.append({"from": low, "to": high, "touches": len(some), "median_m": median_m, "within_1_mm": within})
    return found


def _statistics(run: Run, line: str, metric: str) -> dict[str, Any]:
    metres, shares = run.statistics(line, metric), run.statistics(line, metric, normalised=True)
    return {"metres": asdict(metres), "normalised": asdict(shares)}


def _long_rows(runs: Sequence[Run]) -> Iterator[dict[str, Any]]:
    for run in runs:
        for line in LINES:
            for metric in METRICS:
                names = {"object": run.object, "encoder": run.encoder, "line": line, "metric": metric}
                metres, shares = run.statistics(line, metric), run.statistics(line, metric, normalised=True)
                yield {**names, **tabular.columns(metres, shares)}


_DETAILS = [
    "line", "median", "mean", "std", "quartiles", "90 %", "median / random", "mean / random", "median MSSD",
    "median ADD-S",
]  # fmt: skip


def _detail_rows(run: Run) -> Iterator[list[str]]:
    for line in LINES:
        s, share = run.statistics(line), run.statistics(line, normalised=True)
        lengths = [mm(s.median), mm(s.mean), mm(s.std), f"{mm(s.q25)} to {mm(s.q75)}", mm(s.p90)]
        others = [mm(run.statistics(line, metric).median) for metric in ("mssd", "add-s")]
        yield [line, *lengths, f"{share.median:.3f}", f"{share.mean:.3f}", *others]
