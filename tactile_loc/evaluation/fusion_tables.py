"""Tables of evaluations of several contacts: Markdown and CSV in mm, and JSON in SI units."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation import tabular
from tactile_loc.evaluation.fusion import FUSED_LINES, FUSION_LINES, FUSION_VERSION, FusionEvaluation

SCHEMA_VERSION = 1
NOTE = (
    "ADD of the most probable pose in mm and, in brackets, divided by the mean error of a random pose. Symmetric poses "
    "count as equal. `kinematic` uses contact only, and takes one of the poses that touch all sensors. Without common "
    "pose: examples in which no grid pose touches all sensors; they are located from the first contact only."
)


@dataclass(frozen=True, eq=False)
class FusionRun(tabular.EvaluatedObject):
    """One object evaluated with one encoder, from several touches."""

    evaluation: FusionEvaluation


def tabulate_medians(runs: Sequence[FusionRun], normalised: bool = False) -> tabular.Table:
    """Return a row for each run and line of FUSED_LINES: the median error by number of contacts.

    Errors are in mm or, if `normalised`, divided by the mean error of a random pose. All runs have the same numbers of
    contacts.
    """
    contacts, write = runs[0].evaluation.contacts, "{:.3f}".format if normalised else format_mm
    rows = []
    for run, line in itertools.product(runs, FUSED_LINES):
        medians = (run.summarise(line, n, normalised=normalised).median for n in contacts)
        rows.append([run.object, run.encoder, line, *map(write, medians)])
    return [["object", "encoder", "line", *("1 contact" if n == 1 else f"{n} contacts" for n in contacts)], *rows]


def format_markdown(runs: Sequence[FusionRun], heading: str) -> str:
    """Return all tables as Markdown, lengths in mm."""
    medians = tabular.bracket_shares(tabulate_medians(runs), tabulate_medians(runs, normalised=True), names=3)
    parts = [f"# {heading}\n", f"{NOTE}\n", "Medians:\n", tabular.format_markdown(medians)]
    for run in runs:
        parts.append(f"## {run.object}, {run.encoder}\n")
        parts.append(
            f"{run.grid_poses} grid poses, symmetry {run.symmetry}; "
            f"mean error of a random pose {format_mm(run.evaluation.compute_scale_m())} mm; "
            f"{run.evaluation.refused.sum()} presses without a touch were refused\n"
        )
        parts.append(tabular.format_markdown([_DETAILS, *_list_details(run)]))
    return "\n".join(parts)


def format_csv(runs: Sequence[FusionRun]) -> str:
    """Return one row for each object, encoder, line and number of contacts as CSV, lengths in mm."""
    return tabular.format_csv([
        {
            "object": run.object, "encoder": run.encoder, "line": line, "contacts": n,
            **tabular.list_columns(**run.compare_statistics(line, n)),
            "without_common": run.evaluation.count_without_common(line, n),
        }
        for run in runs for line in FUSED_LINES for n in run.evaluation.contacts
    ])  # fmt: skip


def record_runs(runs: Sequence[FusionRun], protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return all results as JSON values in SI units; `protocol` states the number of examples, noise and seed."""
    asked = {"version": FUSION_VERSION, "contacts": list(runs[0].evaluation.contacts), **protocol}
    return tabular.build_document(SCHEMA_VERSION, asked, [_record_run(run) for run in runs])


def write_fusion_tables(
    folder: Path, runs: Sequence[FusionRun], protocol: Mapping[str, Any], heading: str
) -> list[Path]:
    """Write contacts.json, contacts.csv and contacts.md and return their paths. Raises OutputError."""
    document = tabular.format_json(record_runs(runs, protocol))
    return tabular.write_texts(
        folder, "contacts", json=document, csv=format_csv(runs), md=format_markdown(runs, heading)
    )


def _record_run(run: FusionRun) -> dict[str, Any]:
    found = run.evaluation
    lines = {
        line: [
            {
                "contacts": n,
                **run.record_statistics(line, n),
                "without_common": found.count_without_common(line, n) if line in FUSED_LINES else 0,
                "errors_m": found.select_errors(line, n).tolist(),
            }
            for n in found.contacts
        ]
        for line in FUSION_LINES
    }
    counts = {"examples": len(found.errors_m), "refused": int(found.refused.sum())}
    return run.describe(**counts, random_mean_m=found.compute_scale_m(), lines=lines)


_DETAILS = [
    "line", "contacts", "median", "mean", "std", "quartiles", "median / random", "mean / random", "std / random",
    "without common pose",
]  # fmt: skip


def _list_details(run: FusionRun) -> Iterator[list[str]]:
    for line in FUSED_LINES:
        for n in run.evaluation.contacts:
            s, share = run.compare_statistics(line, n).values()
            shares = [f"{v:.3f}" for v in (share.median, share.mean, share.std)]
            without_common = str(run.evaluation.count_without_common(line, n))
            yield [line, str(n), *tabular.format_lengths(s), *shares, without_common]
