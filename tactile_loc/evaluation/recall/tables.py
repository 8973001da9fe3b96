"""Tables of the evaluation of what `run` answers: Markdown and CSV in mm, and JSON in SI units."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation import tabular
from tactile_loc.evaluation.recall.evaluation import METRICS, RECALL_VERSION, RIGHT_M, VERDICTS
from tactile_loc.evaluation.recall.summary import (
    CURVE_M,
    DIAMETER_SHARES,
    PROBABILITY_BINS,
    WITHIN_M,
    Outcomes,
    RecallRun,
    RecallSummary,
)

SCHEMA_VERSION = 1
NAME = "recall"
EACH = "each_example"  # key of the values of each example
ALL = "all"
RECALL_NOTE = (
    "Errors are surface distances: the mean distance of the surface at the located pose from the surface at the true "
    "pose. The shares are of examples whose first pose (any listed pose) has a smaller error. Examples without a pose "
    "count as missed. AUC: area under the recall curve, the mean of these shares at 0.1, 0.2, ... 5 mm. AR MSSD: the "
    "mean for the largest distance of a surface point, at 5, 10, ... 50 % of the object's diameter, as in BOP."
)
VERDICT_NOTE = (
    "Number of examples with each verdict. Right: share of the certain examples whose first pose is within 1 mm, with "
    "its 95 % confidence interval. Determined: examples in which no listed wrong pose explains the touches as well as "
    "the true pose; share of them that are certain."
)
BIN_NOTE = (
    "Probability of the first pose: its mean, the share of first poses within 1 mm, and the number of examples, for "
    "examples whose probability is in the range of the column."
)


class Group(NamedTuple):
    """The outcomes of all seeds of one object, encoder and noise, for one number of touches."""

    object: str
    encoder: str
    noise: str
    touches: int
    outcomes: Outcomes

    @property
    def label(self) -> list[str]:
        """The first cells of the group's rows."""
        return [self.object, self.encoder, self.noise, str(self.touches)]


LABELS = ("object", "encoder", "noise", "touches")


def group_runs(runs: Sequence[RecallRun]) -> list[Group]:
    """Return a group for each object, encoder, noise and number of touches; then groups of ALL objects, if several."""
    return merge_groups([
        Group(run.object, run.encoder, run.noise, touches, Outcomes.of(run, touches))
        for run in runs
        for touches in run.evaluation.together
    ])  # fmt: skip


def read_groups(document: Mapping[str, Any]) -> list[Group]:
    """Return the groups of a document of `record_runs`, as `group_runs` does."""
    return merge_groups([
        Group(run["object"], run["encoder"], run["noise"], result["touches"], _read_outcomes(result[EACH], run))
        for run in document["runs"]
        for result in run["results"]
    ])  # fmt: skip


def merge_groups(groups: Sequence[Group]) -> list[Group]:
    """Return groups with distinct labels, without those that have no example; then groups of ALL objects, if several.

    Groups with the same label, such as those of several seeds, are joined.
    """
    several = len({group.object for group in groups}) > 1
    every = [*groups, *(group._replace(object=ALL) for group in groups if several)]
    alike: dict[tuple[str, ...], list[Group]] = {}
    for group in every:
        alike.setdefault(tuple(group.label), []).append(group)
    joined = [some[0]._replace(outcomes=Outcomes.join(one.outcomes for one in some)) for some in alike.values()]
    return [group for group in joined if len(group.outcomes)]


def tabulate_recall(groups: Sequence[Group]) -> tabular.Table:
    """Return a row for each group: shares of first and listed poses within WITHIN_M, averages, median in mm, time."""
    heads = [f"< {1e3 * m:g} mm" for m in WITHIN_M]
    rows = [[*LABELS, "examples", *heads, "AUC", "AR MSSD", "median, mm", "s"]]
    for group in groups:
        s = RecallSummary.of(group.outcomes)
        shares = [f"{format_share(a)} ({format_share(b)})" for a, b in zip(s.within, s.listed_within, strict=True)]
        averages = [
            f"{format_share(a)} ({format_share(b)})"
            for a, b in (
                (s.auc, s.listed_auc),
                (s.average_recall_mssd, s.listed_average_recall_mssd),
            )
        ]
        median = "-" if s.median_m is None else format_mm(s.median_m)
        seconds = "-" if s.median_s is None else f"{s.median_s:.2f}"
        rows.append([*group.label, str(s.examples), *shares, *averages, median, seconds])
    return rows


def tabulate_verdicts(groups: Sequence[Group]) -> tabular.Table:
    """Return a row for each group: the number of examples with each verdict, and the verdicts' reliability."""
    rows = [[*LABELS, *VERDICTS, "certain: right", "determined", "of these certain"]]
    for group in groups:
        s = RecallSummary.of(group.outcomes)
        right = "-" if s.certain_right is None else f"{format_share(s.certain_right)} ({_range(s.certain_right_range)})"
        counts = [str(s.verdicts[verdict]) for verdict in VERDICTS]
        rows.append([*group.label, *counts, right, str(s.determined), format_share(s.determined_certain)])
    return rows


def tabulate_bins(groups: Sequence[Group]) -> tabular.Table:
    """Return a row for each group: for each bin of probabilities, the stated and the right share, and the number."""
    heads = [f"{100 * low:.0f} to {100 * high:.0f} %" for low, high in itertools.pairwise(PROBABILITY_BINS)]
    rows = [[*LABELS, *heads]]
    for group in groups:
        bins = RecallSummary.of(group.outcomes).bins
        cells = (
            f"{format_share(b.stated)}, {format_share(b.right)} ({b.examples})" if b.examples else "-" for b in bins
        )
        rows.append([*group.label, *cells])
    return rows


def name_noise(noise: str) -> str:
    """Return the words for a noise: "no noise", "mild noise", or the kind of touches that are not simulated."""
    return {"none": "no noise", "mild": "mild noise", "strong": "strong noise"}.get(noise, noise)


def list_problems(runs: Sequence[RecallRun]) -> list[tuple[str, int]]:
    """Return the reasons why examples have no pose, each with its number of results, the most frequent first."""
    counts: dict[str, int] = {}
    for run in runs:
        for problem in run.evaluation.problem.ravel().tolist():
            if problem:
                counts[problem] = counts.get(problem, 0) + 1
    return sorted(counts.items(), key=lambda item: -item[1])


def count_refused(runs: Sequence[RecallRun]) -> int:
    """Return the number of presses that made no touch."""
    return int(sum(run.evaluation.refused.sum() for run in runs))


def format_markdown(runs: Sequence[RecallRun], heading: str) -> str:
    """Return all tables as Markdown, lengths in mm."""
    groups = group_runs(runs)
    parts = [f"# {heading}\n", f"{RECALL_NOTE}\n", tabular.format_markdown(tabulate_recall(groups))]
    parts += [f"{VERDICT_NOTE}\n", tabular.format_markdown(tabulate_verdicts(groups))]
    parts += [f"{BIN_NOTE}\n", tabular.format_markdown(tabulate_bins(groups))]
    parts.append(f"Presses without a usable touch, which do not count: {count_refused(runs)}\n")
    problems = list_problems(runs)
    if problems:
        parts.append("Examples without a pose:\n")
        parts.append("\n".join(f"- {count}: {problem}" for problem, count in problems) + "\n")
    return "\n".join(parts)


def format_csv(runs: Sequence[RecallRun]) -> str:
    """Return one row for each group as CSV: shares as 0 to 1, lengths in mm, times in seconds."""
    return tabular.format_csv([dict(_list_columns(group)) for group in group_runs(runs)])


def _list_columns(group: Group) -> Iterator[tuple[str, Any]]:
    s = RecallSummary.of(group.outcomes)
    yield from zip(LABELS, group.label, strict=True)
    yield "examples", s.examples
    for name, shares in (("within", s.within), ("listed_within", s.listed_within)):
        yield from ((f"{name}_{1e3 * m:g}_mm", f"{share:.6g}") for m, share in zip(WITHIN_M, shares, strict=True))
    for name in ("auc", "listed_auc", "average_recall_mssd", "listed_average_recall_mssd"):
        yield name, f"{getattr(s, name):.6g}"
    yield "median_mm", _number(None if s.median_m is None else 1e3 * s.median_m)
    yield from ((verdict.replace(" ", "_"), s.verdicts[verdict]) for verdict in VERDICTS)
    yield "certain_right", _number(s.certain_right)
    yield "determined", s.determined
    yield from ((name, _number(getattr(s, name))) for name in ("determined_right", "determined_certain"))
    yield from ((name, _number(getattr(s, name))) for name in ("median_s", "p90_s"))


def record_runs(runs: Sequence[RecallRun], protocol: Mapping[str, Any]) -> dict[str, Any]:
    """Return all results as JSON values in SI units; `protocol` states the examples, noises and seeds."""
    asked = {
        "version": RECALL_VERSION, "together": list(runs[0].evaluation.together), "right_m": RIGHT_M,
        "within_m": list(WITHIN_M), "thresholds_m": [round(m, 9) for m in CURVE_M],
        "diameter_shares": [round(share, 9) for share in DIAMETER_SHARES], **protocol,
    }  # fmt: skip
    return tabular.build_document(SCHEMA_VERSION, asked, [_record_run(run) for run in runs])


def write_recall_tables(
    folder: Path, runs: Sequence[RecallRun], protocol: Mapping[str, Any], heading: str
) -> list[Path]:
    """Write recall.json, recall.csv and recall.md and return their paths. Raises OutputError."""
    document = tabular.format_json(record_runs(runs, protocol))
    return tabular.write_texts(folder, NAME, json=document, csv=format_csv(runs), md=format_markdown(runs, heading))


def _record_run(run: RecallRun) -> dict[str, Any]:
    found = run.evaluation
    results = [
        {"touches": touches, **asdict(RecallSummary.of(outcomes)), EACH: _record_examples(outcomes)}
        for touches in found.together
        if len(outcomes := Outcomes.of(run, touches))
    ]
    return {
        **{key: getattr(run, key) for key in ("object", "symmetry", "diameter_m", "encoder", "noise", "seed")},
        "refused": int(found.refused.sum()), "results": results, "configuration": dict(run.configuration),
    }  # fmt: skip


def _record_examples(outcomes: Outcomes) -> dict[str, Any]:
    """Return the values of each example as lists; a value without a pose is null."""
    kinds = {"errors_m": False, "listed_errors_m": True}
    errors = {
        name: {metric: _drop_infinite(outcomes.select_errors(metric, listed)) for metric in METRICS}
        for name, listed in kinds.items()
    }
    return {
        **errors, "probability": _drop_infinite(outcomes.probability), "verdict": outcomes.verdict.tolist(),
        "problem": outcomes.problem.tolist(), "determined": outcomes.determined.tolist(),
        "seconds": _drop_infinite(outcomes.seconds),
    }  # fmt: skip


def _read_outcomes(each: Mapping[str, Any], run: Mapping[str, Any]) -> Outcomes:
    """Return the outcomes that `_record_examples` recorded."""
    errors_m = np.array([
        [[np.inf if e is None else e for e in each[name][metric]] for metric in METRICS]
        for name in ("errors_m", "listed_errors_m")
    ])  # fmt: skip
    probability, seconds = (np.array(each[name], float) for name in ("probability", "seconds"))  # null becomes NaN
    verdict, problem, determined = (np.array(each[name]) for name in ("verdict", "problem", "determined"))
    diameter_m = np.full(len(verdict), run["diameter_m"])
    return Outcomes(errors_m.transpose(2, 0, 1), probability, verdict, problem, determined, seconds, diameter_m)


def _drop_infinite(values: NDArray[np.float64]) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]


def format_share(share: float | None) -> str:
    """Return a share, 0 to 1, as a whole percentage; "-" without a share."""
    return "-" if share is None else f"{100 * share:.0f} %"


def _range(limits: tuple[float, float] | None) -> str:
    low, high = limits or (0.0, 1.0)
    return f"{100 * low:.0f} to {100 * high:.0f}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
