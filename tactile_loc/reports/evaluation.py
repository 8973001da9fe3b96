"""The report of an evaluation of what `run` answers."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.evaluation.recall import tables
from tactile_loc.evaluation.summary import VERDICTS, bin_probabilities
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.evaluation.text_tables import format_share
from tactile_loc.io.streams.records import read_document
from tactile_loc.io.toml import format_toml
from tactile_loc.reports.page import Page, Section

METRIC_NAMES = {"mssd": "pose error (MSSD)", "add": "ADD", "shape": "shape distance"}
BEYOND_MM = 1e6  # stands for the error of an example without a pose
DIGITS = 5

Run = dict[str, Any]


def make_recall_page(path: Path) -> Page:
    """Return the page of an evaluation from its recall.json. Raises ResultError if the file's version differs."""
    document, runs, table = _read_evaluation(path)
    groups = tables.group_answers(table)
    rows = tables.summarise_answers(table)
    objects = list(dict.fromkeys(name for name, *_ in reversed(groups)))  # all objects come first
    choices = {
        "objects": objects,
        "noises": {noise: tables.name_noise(noise) for _, _, noise, _ in groups},
        "metrics": METRIC_NAMES,
    }
    shown = [row for row in rows if row["object"] == objects[0] or len(objects) == 1]
    unlocated = tables.list_problems(table)
    sections = [
        Section("summary", "", {"numbers": list(_list_shares(shown))}),
        Section("recall", "Recall", {**choices, "note": tables.RECALL_NOTE, "rows": tables.tabulate_recall(rows)}),
        Section("verdicts", "Verdicts", {"rows": tables.tabulate_verdicts(rows)}),
        Section("reliability", "Reliability of the probabilities", {"rows": tables.tabulate_bins(rows)}),
        *([Section("problems", "Examples without a pose", {"problems": unlocated})] if unlocated else []),
        _describe_settings(document, list({run["name"]: run for run in reversed(runs)}.values())[::-1]),
    ]
    data = {
        "groups": [_collect_group(row, some) for row, some in zip(rows, groups.values(), strict=True)],
        "verdicts": list(VERDICTS),
        "reliability": [
            {"touches": touches, "bins": list(_collect_bins(some))}
            for (touches,), some in table.group("touches").items()
        ],
    }
    about = _describe_examples(document)
    return Page("recall", _name_objects(runs), about, sections, data, ["errors.js", "recall.js"])


def _read_evaluation(path: Path) -> tuple[dict[str, Any], list[Run], ExampleTable]:
    """Return a document, its runs and its examples.

    A run's "name" is its object, followed by its encoder if encoders differ.
    """
    document = read_document(path)
    found = document.get("schema_version")
    if found != tables.SCHEMA_VERSION:
        raise ResultError(
            f"{path} has version {found}, and this tactile-loc reads version {tables.SCHEMA_VERSION}; make it again "
            "with the same command"
        )
    runs = document["runs"]
    if not runs:
        raise ValueError("it has no runs")
    several = len({run["encoder"] for run in runs}) > 1
    named = [{**run, "name": f"{run['object']}, {run['encoder']}" if several else str(run["object"])} for run in runs]
    return document, named, ExampleTable.read(document["examples"])


def _describe_settings(document: Mapping[str, Any], runs: Sequence[Run]) -> Section:
    """Return the section with the object and configuration of every run, and with the software versions."""
    settings = [
        (
            run["name"],
            f"{run['name']}: symmetry {run['symmetry']}, encoder {run['encoder']}",
            format_toml(run.get("configuration", {})),
        )
        for run in runs
    ]
    return Section("made", "Settings", {"runs": settings, "versions": list(document["versions"].items())})


def _name_objects(runs: Sequence[Run]) -> str:
    objects = list(dict.fromkeys(run["object"] for run in runs))
    return f"Evaluation: {', '.join(objects) if len(objects) < 7 else f'{len(objects)} objects'}"


def _describe_examples(document: Mapping[str, Any]) -> str:
    protocol = document["protocol"]
    if "touches" in protocol:
        what = f"{protocol['examples']} examples of own touches ({', '.join(protocol['touches'])})"
    else:
        noises, seeds = (", ".join(map(str, protocol[name])) for name in ("noises", "seeds"))
        what = f"{protocol['examples']} simulated examples for each object, noise {noises}, seed {seeds}"
    return f"{what}; protocol {protocol['version']}; {document['created']}"


def _list_shares(rows: Sequence[Run]) -> Iterator[tuple[str, str, str]]:
    """Yield the main numbers: for each group, the recall at 1 mm, and the reliability of the verdict "certain"."""
    for row in rows:
        half, one, five = map(format_share, row["within"])
        right = "" if row["certain_right"] is None else f", {format_share(row['certain_right'])} of them right"
        touches = "1 touch" if row["touches"] == 1 else f"{row['touches']} touches"
        certain = row["verdicts"]["certain"]
        shares = f"within 1 mm; {half} within 0.5 mm, {five} within 5 mm; {certain} certain{right}"
        yield f"{touches}, {tables.name_noise(row['noise'])}", one, shares


def _collect_group(row: Run, table: ExampleTable) -> dict[str, Any]:
    """Return the values of a group for the page's scripts, in mm and %."""
    errors = {
        line: {metric: _sort_errors_mm(table.errors_m(line, metric)) for metric in METRIC_NAMES}
        for line in ("first", "listed")
    }
    labels = {name: row[name] for name in tables.GROUP}
    return {**labels, "errors_mm": errors, "verdicts": [row["verdicts"][verdict] for verdict in VERDICTS]}


def _collect_bins(table: ExampleTable) -> Iterator[dict[str, Any]]:
    """Yield the reliability of the probabilities in each bin, in %, for the page's scripts."""
    for one in bin_probabilities(table):
        if one.stated is not None and one.right is not None:
            yield {"stated": 100 * one.stated, "right": 100 * one.right, "examples": one.examples}


def _sort_errors_mm(errors_m: Floats) -> list[float]:
    """Return errors (E,), metres, in mm in ascending order; BEYOND_MM stands for an example without a pose."""
    return [float(f"{value:.{DIGITS}g}") for value in np.minimum(1e3 * np.sort(errors_m), BEYOND_MM)]
