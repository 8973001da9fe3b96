"""The report of an evaluation of what `run` answers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.evaluation.recall import tables
from tactile_loc.evaluation.recall.evaluation import METRICS, VERDICTS
from tactile_loc.evaluation.recall.summary import Outcomes, RecallSummary, bin_probabilities
from tactile_loc.reports.evaluation import describe_settings, read_runs
from tactile_loc.reports.page import Page, Section

METRIC_NAMES = {"surface": "surface distance", "add": "ADD", "mssd": "MSSD"}
BEYOND_MM = 1e6  # stands for the error of an example without a pose
DIGITS = 5


def make_recall_page(path: Path) -> Page:
    """Return the page of an evaluation from its recall.json. Raises ResultError if the file's version differs."""
    document, runs = read_runs(path, tables.SCHEMA_VERSION)
    groups = tables.read_groups(document)
    several = len({group.object for group in groups}) > 1
    shown = [group for group in groups if not several or group.object == tables.ALL]
    sections = [
        Section("summary", "", {"numbers": list(_list_numbers(shown))}),
        Section("recall", "Recall", {**_list_choices(groups), "rows": tables.tabulate_recall(groups)}),
        Section("verdicts", "Verdicts", {"rows": tables.tabulate_verdicts(groups)}),
        Section("reliability", "Reliability of the probabilities", {"rows": tables.tabulate_bins(groups)}),
        Section("problems", "Examples without a pose", {"problems": _count_problems(groups)}),
        describe_settings(document, _drop_repeated(runs)),
    ]
    kept = [section for section in sections if section.values.get("problems", True)]
    objects = list(dict.fromkeys(run["object"] for run in runs))
    title = f"Evaluation: {', '.join(objects) if len(objects) < 7 else f'{len(objects)} objects'}"
    data = {
        "groups": [_collect_group(group) for group in groups], "verdicts": list(VERDICTS),
        "reliability": list(_collect_bins(shown)),
    }  # fmt: skip
    return Page("recall", title, _describe_protocol(document), kept, data, ["errors.js", "recall.js"])


def _describe_protocol(document: Mapping[str, Any]) -> str:
    protocol = document["protocol"]
    if "touches" in protocol:
        what = f"{protocol['examples']} examples of own touches ({', '.join(protocol['touches'])})"
    else:
        noises, seeds = (", ".join(map(str, protocol[name])) for name in ("noises", "seeds"))
        kind = "simulated images" if protocol["images"] else f"noise {noises}"
        what = f"{protocol['examples']} simulated examples for each object, {kind}, seed {seeds}"
    return f"{what}; protocol {protocol['version']}; {document['created']}"


def _list_numbers(groups: Sequence[tables.Group]) -> Iterator[tuple[str, str, str]]:
    """Yield the main numbers: for each group, the recall at 1 mm, and the reliability of the verdict "certain"."""
    for group in groups:
        s = RecallSummary.of(group.outcomes)
        half, one, five = map(tables.format_share, s.within)
        certain = s.verdicts["certain"]
        right = "" if s.certain_right is None else f", {tables.format_share(s.certain_right)} of them right"
        name = f"{group.touches} {'touch' if group.touches == 1 else 'touches'}, {tables.name_noise(group.noise)}"
        yield name, one, f"within 1 mm; {half} within 0.5 mm, {five} within 5 mm; {certain} certain{right}"


def _list_choices(groups: Sequence[tables.Group]) -> dict[str, Any]:
    objects = list(dict.fromkeys(group.object for group in reversed(groups)))  # all objects come first
    return {
        "objects": objects,
        "noises": {noise: tables.name_noise(noise) for noise in dict.fromkeys(group.noise for group in groups)},
        "metrics": {metric: METRIC_NAMES[metric] for metric in METRICS},
    }


def _count_problems(groups: Sequence[tables.Group]) -> list[tuple[str, int]]:
    counts: Counter[str] = Counter()
    for group in groups:
        if group.object != tables.ALL:
            counts.update(problem for problem in group.outcomes.problem.tolist() if problem)
    return counts.most_common()


def _drop_repeated(runs: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the first run of each name, because the runs of several noises and seeds have the same settings."""
    return list({run["name"]: run for run in reversed(runs)}.values())[::-1]


def _collect_group(group: tables.Group) -> dict[str, Any]:
    """Return the values of a group for the page's scripts, in mm and %."""
    outcomes, s = group.outcomes, RecallSummary.of(group.outcomes)
    errors = {
        kind: {metric: _round_mm(outcomes.select_errors(metric, listed)) for metric in METRICS}
        for kind, listed in (("first", False), ("listed", True))
    }
    return {
        "object": group.object, "encoder": group.encoder, "noise": group.noise, "touches": group.touches,
        "errors_mm": errors, "verdicts": [s.verdicts[verdict] for verdict in VERDICTS],
    }  # fmt: skip


def _collect_bins(groups: Sequence[tables.Group]) -> Iterator[dict[str, Any]]:
    """Yield the reliability of the probabilities for each number of touches, over all groups, in %."""
    for touches in dict.fromkeys(group.touches for group in groups):
        joined = Outcomes.join(group.outcomes for group in groups if group.touches == touches)
        yield {
            "touches": touches,
            "bins": [
                {"stated": 100 * b.stated, "right": 100 * b.right, "examples": b.examples}
                for b in bin_probabilities(joined)
                if b.stated is not None and b.right is not None
            ],
        }


def _round_mm(errors_m: NDArray[np.float64]) -> list[float]:
    return [float(f"{min(1e3 * e, BEYOND_MM):.{DIGITS}g}") for e in np.sort(errors_m)]
