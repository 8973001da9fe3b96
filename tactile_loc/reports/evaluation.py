"""The reports of evaluations: by the paper's protocol from one touch and from several contacts, and of answers."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation import metrics
from tactile_loc.evaluation.paper import tables as paper_tables
from tactile_loc.evaluation.paper.single_touches import METRICS
from tactile_loc.evaluation.protocol import LINES
from tactile_loc.evaluation.recall import tables
from tactile_loc.evaluation.summary import VERDICTS, bin_probabilities
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.evaluation.text_tables import format_share
from tactile_loc.io.streams.records import read_document
from tactile_loc.io.toml import format_toml
from tactile_loc.reports.page import Page, Section
from tactile_loc.reports.pictures import encode_gallery

METRIC_NAMES = {"mssd": "pose error (MSSD)", "add": "ADD", "add-s": "ADD-S", "shape": "shape distance"}
FIRST_LINE = "chosen"  # error that the curves show first
CONTACTS_LINE = "best-1"  # error in the main numbers for several contacts
BEYOND_MM = 1e6  # stands for the error of an example without a pose
DIGITS, DIGITS_OF_ANSWERS = 6, 5

Run = dict[str, Any]


def make_evaluation_page(path: Path) -> Page:
    """Return the page of an evaluation from its results.json. Raises ResultError if the file's version differs."""
    document, runs, table = read_evaluation(path, paper_tables.TOUCH_SCHEMA)
    lines = document["summary"]
    medians = {
        kind: paper_tables.tabulate_medians(lines, cell)
        for kind, cell in (("lengths", paper_tables.format_median), ("shares", paper_tables.format_share_of_random))
    }
    sections = [
        Section("summary", "", {"numbers": list(_list_numbers(document, runs))}),
        Section("medians", "Medians", medians),
        Section("errors", "Errors", _list_choices(runs)),
        Section("posterior", "Calibration of the probabilities", {"rows": paper_tables.tabulate_posteriors(runs)}),
        Section("times", "Times", {"rows": paper_tables.tabulate_times(runs)}),
        Section("gallery", "Best, median and worst touches", {"pictures": _collect_gallery(path.parent, runs)}),
        describe_settings(document, runs),
    ]
    shown = [section for section in sections if section.values.get("pictures", True)]
    kind = "simulated images" if document["protocol"].get("images") else "simulated touches"
    by_run = table.group("object", "encoder")
    data = {"runs": [_collect_errors(run, by_run[run["object"], run["encoder"]]) for run in runs], "lines": list(LINES)}
    about = _describe_protocol(document, "touches", kind)
    return Page("evaluation", _name_objects(runs), about, shown, data, ["errors.js", "evaluation.js"])


def make_contacts_page(path: Path) -> Page:
    """Return the page of an evaluation with several contacts from its contacts.json.

    Raises ResultError if the file's version differs.
    """
    document, runs, _ = read_evaluation(path, paper_tables.CONTACTS_SCHEMA)
    rows = document["summary"]
    lines = list(dict.fromkeys(row["line"] for row in rows))
    alone = [row for row in rows if row["line"] == CONTACTS_LINE]
    without = paper_tables.tabulate_contacts(alone, lambda row: str(row["without_common"]), ("object", "encoder"))
    sections = [
        Section("summary", "", {"numbers": [_summarise_contacts(document, run) for run in runs]}),
        Section("curves", "Errors by number of contacts", {"lines": ["all", *lines]}),
        Section("medians", "Medians", {"rows": paper_tables.tabulate_contacts(rows), "without": without}),
        describe_settings(document, runs),
    ]
    title = f"Several contacts: {', '.join(dict.fromkeys(run['object'] for run in runs))}"
    drawn = [{line: _collect_quartiles(_select_rows(document, run, line)) for line in lines} for run in runs]
    data = {"runs": [{"name": run["name"], "lines": some} for run, some in zip(runs, drawn, strict=True)]}
    about = _describe_protocol(document, "examples", "simulated examples")
    return Page("contacts", title, about, sections, data, ["errors.js", "contacts.js"])


def make_recall_page(path: Path) -> Page:
    """Return the page of an evaluation from its recall.json. Raises ResultError if the file's version differs."""
    document, runs, table = read_evaluation(path, tables.SCHEMA_VERSION)
    groups = tables.group_answers(table)
    rows = tables.summarise_answers(table)
    objects = list(dict.fromkeys(name for name, *_ in reversed(groups)))  # all objects come first
    choices = {
        "objects": objects,
        "noises": {noise: tables.name_noise(noise) for _, _, noise, _ in groups},
        "metrics": {metric: METRIC_NAMES[metric] for metric in metrics.METRICS},
    }
    shown = [row for row in rows if row["object"] == objects[0] or len(objects) == 1]
    unlocated = tables.list_problems(table)
    sections = [
        Section("summary", "", {"numbers": list(_list_shares(shown))}),
        Section("recall", "Recall", {**choices, "note": tables.RECALL_NOTE, "rows": tables.tabulate_recall(rows)}),
        Section("verdicts", "Verdicts", {"rows": tables.tabulate_verdicts(rows)}),
        Section("reliability", "Reliability of the probabilities", {"rows": tables.tabulate_bins(rows)}),
        *([Section("problems", "Examples without a pose", {"problems": unlocated})] if unlocated else []),
        describe_settings(document, list({run["name"]: run for run in reversed(runs)}.values())[::-1]),
    ]
    data = {
        "groups": [_collect_group(row, some) for row, some in zip(rows, groups.values(), strict=True)],
        "verdicts": list(VERDICTS),
        "reliability": [
            {"touches": touches, "bins": list(collect_bins(some))}
            for (touches,), some in table.group("touches").items()
        ],
    }
    about = _describe_examples(document)
    return Page("recall", _name_objects(runs), about, sections, data, ["errors.js", "recall.js"])


def read_evaluation(path: Path, version: int) -> tuple[dict[str, Any], list[Run], ExampleTable]:
    """Return a document, its runs and its examples.

    A run's "name" is its object, followed by its encoder if encoders differ.
    """
    document = read_document(path)
    found = document.get("schema_version")
    if found != version:
        raise ResultError(
            f"{path} has version {found}, and this tactile-loc reads version {version}; make it again with the same "
            "command"
        )
    runs = document["runs"]
    if not runs:
        raise ValueError("it has no runs")
    several = len({run["encoder"] for run in runs}) > 1
    named = [{**run, "name": f"{run['object']}, {run['encoder']}" if several else str(run["object"])} for run in runs]
    return document, named, ExampleTable.read(document["examples"])


def describe_settings(document: Mapping[str, Any], runs: Sequence[Run]) -> Section:
    """Return the section with the object and configuration of every run, and with the software versions."""
    settings = [
        (
            run["name"],
            f"{run['name']}: {_describe_grid(run)}symmetry {run['symmetry']}, encoder {run['encoder']}",
            format_toml(run.get("configuration", {})),
        )
        for run in runs
    ]
    return Section("made", "Settings", {"runs": settings, "versions": list(document["versions"].items())})


def _name_objects(runs: Sequence[Run]) -> str:
    objects = list(dict.fromkeys(run["object"] for run in runs))
    return f"Evaluation: {', '.join(objects) if len(objects) < 7 else f'{len(objects)} objects'}"


def _describe_grid(run: Run) -> str:
    return f"{run['grid_poses']} grid poses, " if "grid_poses" in run else ""


def _describe_protocol(document: Mapping[str, Any], counted: str, what: str) -> str:
    protocol = document["protocol"]
    return (
        f"{protocol[counted]} {what} for each object, noise {protocol['noise']}, seed {protocol['seed']}; "
        f"protocol {protocol['version']}; {document['created']}"
    )


def _describe_examples(document: Mapping[str, Any]) -> str:
    protocol = document["protocol"]
    if "touches" in protocol:
        what = f"{protocol['examples']} examples of own touches ({', '.join(protocol['touches'])})"
    else:
        noises, seeds = (", ".join(map(str, protocol[name])) for name in ("noises", "seeds"))
        kind = "simulated images" if protocol["images"] else f"noise {noises}"
        what = f"{protocol['examples']} simulated examples for each object, {kind}, seed {seeds}"
    return f"{what}; protocol {protocol['version']}; {document['created']}"


def _select_rows(document: Mapping[str, Any], run: Run, line: str) -> list[Run]:
    """Return the rows of the summary of a run for a line and ADD: one for each number of contacts."""
    wanted = {"object": run["object"], "encoder": run["encoder"], "line": line, "metric": "add"}
    return [row for row in document["summary"] if wanted.items() <= row.items()]


# ---- from one touch


def _list_numbers(document: Mapping[str, Any], runs: Sequence[Run]) -> Iterator[tuple[str, str, str]]:
    medians = [row for run in runs for row in _select_rows(document, run, FIRST_LINE)]
    middle_m, share = (float(np.median([row[f"median_{unit}"] for row in medians])) for unit in ("m", "normalised"))
    of_all = f"the median of {len(runs)} medians" if len(runs) > 1 else f"of {runs[0]['object']}"
    yield f"median ADD, {FIRST_LINE}", f"{format_mm(middle_m)} mm", of_all
    yield "normalised", f"{share:.3f}", "the same, divided by the mean error of random poses"
    ambiguous = float(np.mean([run["ambiguous"] for run in runs]))
    yield "ambiguous touches", format_share(ambiguous), "a distant pose makes the same contact, within noise"
    for level, *held in zip(runs[0]["levels"], *(run["coverage"] for run in runs), strict=True):
        ideal = f"of the true poses; ideal: {format_share(level)}"
        yield paper_tables.name_set(level), format_share(float(np.mean(held))), ideal


def _list_choices(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the objects, metrics and lines that a reader can choose for the plots of errors."""
    objects = {"": "all, by line", **{str(i): run["name"] for i, run in enumerate(runs)}}
    return {
        "objects": objects if len(runs) > 1 else {"0": runs[0]["name"]},
        "metrics": {metric: METRIC_NAMES[metric] for metric in METRICS},
        "lines": list(LINES),
        "first": FIRST_LINE,
    }


def _collect_gallery(folder: Path, runs: Sequence[Run]) -> list[tuple[str, str]]:
    """Return the label and data URI of each run's picture. Pictures outside of the folder are ignored."""
    found = []
    for run in runs:
        path = folder / f"gallery-{run['object']}-{run['encoder']}.png"
        uri = encode_gallery(path) if path.parent == folder else None
        if uri is not None:
            found.append((f"touches of {run['object']} with {run['encoder']}", uri))
    return found


def _collect_errors(run: Run, table: ExampleTable) -> dict[str, Any]:
    """Return the values of a run for the page's scripts, in mm, nats and ms."""
    return {
        "name": run["name"],
        "errors_mm": {
            line: {metric: _round(1e3 * table.errors_m(line, metric)) for metric in METRICS} for line in LINES
        },
        "random_mm": {metric: 1e3 * value for metric, value in run["random_mean_m"].items()},
        "credible_level": _round(table["credible_level"]),
        "entropy": _round(table["entropy_nats"]),
        "levels": run["levels"],
        "coverage": run["coverage"],
        "times": [[stage, 1e3 * s] for stage, s in run["median_seconds"].items()],
    }


def _round(values: Floats, digits: int = DIGITS) -> list[float]:
    return [float(f"{value:.{digits}g}") for value in values]


# ---- from several contacts


def _summarise_contacts(document: Mapping[str, Any], run: Run) -> tuple[str, str, str]:
    rows = _select_rows(document, run, CONTACTS_LINE)
    medians, numbers = zip(
        *((format_mm(row["median_m"]), paper_tables.name_contacts(row["contacts"])) for row in (rows[0], rows[-1])),
        strict=True,
    )
    return run["name"], f"{' → '.join(medians)} mm", f"median ADD from {' to '.join(numbers)}"


def _collect_quartiles(rows: Sequence[Run]) -> dict[str, Any]:
    """Return the medians and quartiles of a line for the page's scripts, in mm and as shares."""
    kinds = {"metres": ("m", 1e3), "normalised": ("normalised", 1.0)}
    quartiles = {
        kind: {name: [factor * row[f"{name}_{unit}"] for row in rows] for name in ("median", "q25", "q75")}
        for kind, (unit, factor) in kinds.items()
    }
    return {"contacts": [row["contacts"] for row in rows], **quartiles}


# ---- answers


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
        line: {metric: sort_errors_mm(table.errors_m(line, metric)) for metric in metrics.METRICS}
        for line in ("first", "listed")
    }
    labels = {name: row[name] for name in tables.GROUP}
    return {**labels, "errors_mm": errors, "verdicts": [row["verdicts"][verdict] for verdict in VERDICTS]}


def collect_bins(table: ExampleTable) -> Iterator[dict[str, Any]]:
    """Yield the reliability of the probabilities in each bin, in %, for the page's scripts."""
    for one in bin_probabilities(table):
        if one.stated is not None and one.right is not None:
            yield {"stated": 100 * one.stated, "right": 100 * one.right, "examples": one.examples}


def sort_errors_mm(errors_m: Floats, digits: int = DIGITS_OF_ANSWERS) -> list[float]:
    """Return errors (E,), metres, in mm in ascending order; BEYOND_MM stands for an example without a pose."""
    return _round(np.minimum(1e3 * np.sort(errors_m), BEYOND_MM), digits)
