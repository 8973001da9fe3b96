"""Evaluations of several contacts as tables: Markdown and CSV for people, in mm, and JSON in SI units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tactile_loc.core.formatting import mm
from tactile_loc.evaluation import tabular
from tactile_loc.evaluation.fusion import FUSED_LINES, FUSION_LINES, FUSION_VERSION, FusionEvaluation

SCHEMA_VERSION = 1
NOTE = (
    "ADD of the most probable pose in mm and, in brackets, divided by the mean error of a random pose; symmetry "
    "regarded. `kinematic` knows of contact only, and takes one of the poses that touch all sensors. Without common "
    "pose: examples in which no pose of the grid touches all sensors, located from the first contact alone."
)


@dataclass(frozen=True, eq=False)
class FusionRun(tabular.EvaluatedObject):
    """One object evaluated with one encoder, from several touches."""

    evaluation: FusionEvaluation

    def statistics(self, line: str, contacts: int, normalised: bool = False) -> tabular.Statistics:
        """Return the statistics of a line: in metres, or as shares of the mean random error if `normalised`."""
        found = self.evaluation
        return tabular.Statistics.of(found.normalised(line, contacts) if normalised else found.errors(line, contacts))


def median_header(runs: Sequence[FusionRun]) -> list[str]:
    """Return the heads of the columns of `median_rows`; all runs have the same numbers of contacts."""
    return ["object", "encoder", "line", *(f"{n} {_contacts(n)}" for n in runs[0].evaluation.contacts)]


def median_rows(runs: Sequence[FusionRun], normalised: bool) -> list[list[str]]:
    """Return a row of cells for each run and line of FUSED_LINES: the median error by number of contacts.

    In mm, or as a share of a random pose's mean error if `normalised`.
    """
    rows = []
    for run in runs:
        for line in FUSED_LINES:
            medians = [run.statistics(line, n, normalised).median for n in run.evaluation.contacts]
            cells = [f"{m:.3f}" if normalised else mm(m) for m in medians]
            rows.append([run.object, run.encoder, line, *cells])
    return rows


def markdown(runs: Sequence[FusionRun], heading: str) -> str:
    """Return all tables as Markdown, the lengths in mm."""
    medians = tabular.bracketed(median_rows(runs, False), median_rows(runs, True), names=3)
    parts = [f"# {heading}\n", f"{NOTE}\n", "Medians:\n", tabular.markdown_table(median_header(runs), medians)]
    for run in runs:
        random = mm(run.evaluation.scale_m())
        parts.append(f"## {run.object}, {run.encoder}\n")
        parts.append(
            f"{run.grid_poses} grid poses, symmetry {run.symmetry}; a random pose: {random} mm in the mean; "
            f"{run.evaluation.refused.sum()} presses that showed no touch were refused\n"
        )
        parts.append(tabular.markdown_table(_DETAILS, list(_detail_rows(run))))
    return "\n".join(parts)


def csv_text(runs: Sequence[FusionRun]) -> str:
    """Return one row for each object, encoder, line and number of contacts as CSV, lengths in mm."""
    return tabular.csv_table(list(_long_rows(runs)))


def record(runs: Sequence[FusionRun], protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return everything as JSON values in SI units; `protocol` says how many examples, which noise and seed."""
    asked = {"version": FUSION_VERSION, "contacts": list(runs[0].evaluation.contacts), **protocol}
    return tabular.document(SCHEMA_VERSION, asked, [_run_record(run) for run in runs])


def write_fusion_tables(
    folder: Path, runs: Sequence[FusionRun], protocol: Mapping[str, Any], heading: str
) -> list[Path]:
    """Write contacts.json, contacts.csv and contacts.md and return their paths. Raises OutputError."""
    return tabular.write_all(folder, "contacts", record(runs, protocol), csv_text(runs), markdown(runs, heading))


def _contacts(count: int) -> str:
    return "contact" if count == 1 else "contacts"


def _run_record(run: FusionRun) -> dict[str, Any]:
    found = run.evaluation
    lines = {
        line: [
            {
                "contacts": n,
                "metres": asdict(run.statistics(line, n)),
                "normalised": asdict(run.statistics(line, n, normalised=True)),
                "without_common": found.without_common(line, n) if line in FUSED_LINES else 0,
                "errors_m": found.errors(line, n).tolist(),
            }
            for n in found.contacts
        ]
        for line in FUSION_LINES
    }
    counts = {"examples": len(found.errors_m), "refused": int(found.refused.sum())}
    return run.record(**counts, random_mean_m=found.scale_m(), lines=lines)


def _long_rows(runs: Sequence[FusionRun]) -> Iterator[dict[str, Any]]:
    for run in runs:
        for line in FUSED_LINES:
            for n in run.evaluation.contacts:
                names = {"object": run.object, "encoder": run.encoder, "line": line, "contacts": n}
                metres, shares = run.statistics(line, n), run.statistics(line, n, normalised=True)
                without = run.evaluation.without_common(line, n)
                yield {**names, **tabular.columns(metres, shares), "without_common": without}


_DETAILS = [
    "line", "contacts", "median", "mean", "std", "quartiles", "median / random", "mean / random", "std / random",
    "without common pose",
]  # fmt: skip


def _detail_rows(run: FusionRun) -> Iterator[list[str]]:
    for line in FUSED_LINES:
        for n in run.evaluation.contacts:
            s, share = run.statistics(line, n), run.statistics(line, n, normalised=True)
            lengths = [mm(s.median), mm(s.mean), mm(s.std), f"{mm(s.q25)} to {mm(s.q75)}"]
            shares = [f"{v:.3f}" for v in (share.median, share.mean, share.std)]
            yield [line, str(n), *lengths, *shares, str(run.evaluation.without_common(line, n))]
