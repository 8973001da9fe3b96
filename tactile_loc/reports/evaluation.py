"""The reports of evaluations, from one touch and from several contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.core.runtime.formatting import format_mm
from tactile_loc.evaluation import fusion_tables, tables
from tactile_loc.evaluation.metrics import LEVELS
from tactile_loc.io.streams.records import read_document
from tactile_loc.io.toml import format_toml
from tactile_loc.reports.page import Page, Section
from tactile_loc.reports.pictures import encode_gallery

METRIC_NAMES = {"add": "ADD", "mssd": "MSSD", "add-s": "ADD-S"}
FIRST_LINE = "chosen"  # error that the curves show first, if the evaluation has this error
CONTACTS_LINE = "best-1"  # error in the main numbers for several contacts
UNITS = {"metres": 1e3, "normalised": 1.0}  # names of statistics, and their factors to mm and shares
DIGITS = 6

Run = Mapping[str, Any]


def make_evaluation_page(path: Path) -> Page:
    """Return the page of an evaluation from its results.json. Raises ResultError if the file's version differs."""
    document, runs = read_runs(path, tables.SCHEMA_VERSION)
    lines, metrics = list(runs[0]["errors_m"]), list(next(iter(runs[0]["errors_m"].values())))
    sections = [
        Section("summary", "", {"numbers": _list_numbers(runs, _choose_first(lines))}),
        Section("medians", "Medians", _tabulate_medians(runs)),
        Section("errors", "Errors", _list_choices(runs, lines, metrics)),
        Section("posterior", "Calibration of the probabilities", _tabulate_posteriors(runs)),
        Section("times", "Times", _tabulate_times(runs)),
        Section("gallery", "Best, median and worst touches", {"pictures": _collect_gallery(path.parent, runs)}),
        describe_settings(document, runs),
    ]
    shown = [section for section in sections if section.values.get("pictures", True)]
    objects = list(dict.fromkeys(run["object"] for run in runs))
    title = f"Evaluation: {', '.join(objects) if len(objects) < 7 else f'{len(objects)} objects'}"
    kind = "simulated images" if document["protocol"].get("images") else "simulated touches"
    data = {"runs": [_collect_errors(run) for run in runs], "lines": lines}
    about = _describe_protocol(document, "touches", kind)
    return Page("evaluation", title, about, shown, data, ["errors.js", "evaluation.js"])


def make_contacts_page(path: Path) -> Page:
    """Return the page of an evaluation with several contacts from its contacts.json.

    Raises ResultError if the file's version differs.
    """
    document, runs = read_runs(path, fusion_tables.SCHEMA_VERSION)
    sections = [
        Section("summary", "", {"numbers": [_summarise_contacts(run) for run in runs]}),
        Section("curves", "Errors by number of contacts", {"lines": ["all", *runs[0]["lines"]]}),
        Section("medians", "Medians", _tabulate_contacts(runs)),
        describe_settings(document, runs),
    ]
    title = f"Several contacts: {', '.join(dict.fromkeys(run['object'] for run in runs))}"
    data = {"runs": [_collect_quartiles(run) for run in runs]}
    about = _describe_protocol(document, "examples", "simulated examples")
    return Page("contacts", title, about, sections, data, ["errors.js", "contacts.js"])


def read_runs(path: Path, version: int) -> tuple[dict[str, Any], list[Run]]:
    """Return a document and its runs. A run's "name" is its object, followed by its encoder if encoders differ."""
    document = read_document(path)
    found = document.get("schema_version")
    if found != version:
        raise ResultError(f"{path} has version {found}, and this tactile-loc reads version {version}; make it again")
    runs = document["runs"]
    if not runs:
        raise ValueError("it has no runs")
    several = len({run["encoder"] for run in runs}) > 1
    return document, [
        {**run, "name": f"{run['object']}, {run['encoder']}" if several else str(run["object"])} for run in runs
    ]


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


def _describe_grid(run: Run) -> str:
    return f"{run['grid_poses']} grid poses, " if "grid_poses" in run else ""


def _describe_protocol(document: Mapping[str, Any], counted: str, what: str) -> str:
    protocol = document["protocol"]
    return (
        f"{protocol[counted]} {what} for each object, noise {protocol['noise']}, seed {protocol['seed']}; "
        f"protocol {protocol['version']}; {document['created']}"
    )


# ---- from one touch


def _choose_first(lines: Sequence[str]) -> str:
    return FIRST_LINE if FIRST_LINE in lines else lines[0]


def _list_numbers(runs: Sequence[Run], line: str) -> list[tuple[str, str, str]]:
    medians = [run["lines"][line]["add"] for run in runs]
    ambiguous = float(np.mean([run["ambiguity"]["ambiguous"] for run in runs]))
    middle_mm = format_mm(float(np.median([m["metres"]["median"] for m in medians])))
    share = float(np.median([m["normalised"]["median"] for m in medians]))
    covered = np.mean([run["posterior"]["coverage"] for run in runs], axis=0)
    of_all = f"the median of {len(runs)} medians" if len(runs) > 1 else f"of {runs[0]['object']}"
    sets = [
        (_name_set(level), f"{100 * held:.0f} %", f"of the true poses; ideal: {100 * level:.0f} %")
        for level, held in zip(_list_levels(runs[0]), covered, strict=True)
    ]
    return [
        (f"median ADD, {line}", f"{middle_mm} mm", of_all),
        ("normalised", f"{share:.3f}", "the same, divided by the mean error of random poses"),
        ("ambiguous touches", f"{100 * ambiguous:.0f} %", "a distant pose makes the same contact, within noise"),
        *sets,
    ]


def _list_levels(run: Run) -> list[float]:
    return list(run["posterior"].get("levels", LEVELS))


def _name_set(level: float) -> str:
    return f"in the {100 * level:.0f} % set"


def _tabulate_medians(runs: Sequence[Run]) -> dict[str, Any]:
    lines = [line for line in tables.SHOWN if line in runs[0]["lines"]]
    lengths, shares = (
        [[run["name"], run["grid_poses"], *(write(run["lines"][line]["add"][unit]["median"]) for line in lines)]
         for run in runs]
        for unit, write in (("metres", format_mm), ("normalised", "{:.3f}".format))
    )  # fmt: skip
    return {"header": ["object", "grid poses", *lines], "lengths": lengths, "shares": shares}


def _list_choices(runs: Sequence[Run], lines: Sequence[str], metrics: Sequence[str]) -> dict[str, Any]:
    """Return the objects, metrics and lines that a reader can choose for the plots of errors."""
    objects = {"": "all, by line", **{str(i): run["name"] for i, run in enumerate(runs)}}
    return {
        "objects": objects if len(runs) > 1 else {"0": runs[0]["name"]},
        "metrics": {metric: METRIC_NAMES.get(metric, metric) for metric in metrics},
        "lines": lines,
        "first": _choose_first(lines),
    }


def _tabulate_posteriors(runs: Sequence[Run]) -> dict[str, Any]:
    header = ["object", *map(_name_set, _list_levels(runs[0])), "NLL (nats)", "uniform NLL (nats)", "entropy (nats)",
              "expected error (mm)", "spread (mm)"]  # fmt: skip
    rows = []
    for run in runs:
        posterior = run["posterior"]
        held = [f"{100 * share:.0f} %" for share in posterior["coverage"]]
        nats = [f"{posterior[key]:.2f}" for key in ("nll", "uniform_nll", "entropy")]
        rows.append(
            [run["name"], *held, *nats, format_mm(posterior["expected_error_m"]), format_mm(posterior["spread_m"])]
        )
    return {"header": header, "rows": rows}


def _tabulate_times(runs: Sequence[Run]) -> dict[str, Any]:
    stages = list(runs[0]["median_seconds"])
    rows = [[run["name"], *(f"{1e3 * run['median_seconds'][stage]:.2f}" for stage in stages)] for run in runs]
    return {"header": ["object", *(f"{stage} (ms)" for stage in stages)], "rows": rows}


def _collect_gallery(folder: Path, runs: Sequence[Run]) -> list[tuple[str, str]]:
    """Return the label and data URI of each run's picture. Pictures outside of the folder are ignored."""
    found = []
    for run in runs:
        path = folder / f"gallery-{run['object']}-{run['encoder']}.png"
        uri = encode_gallery(path) if path.parent == folder else None
        if uri is not None:
            found.append((f"touches of {run['object']} with {run['encoder']}", uri))
    return found


def _collect_errors(run: Run) -> dict[str, Any]:
    """Return the values of a run for the page's scripts, in mm, nats and ms."""
    errors = {
        line: {metric: [_round(1e3 * e) for e in values] for metric, values in by_metric.items()}
        for line, by_metric in run["errors_m"].items()
    }
    return {
        "name": run["name"], "errors_mm": errors, "random_mm": {m: 1e3 * v for m, v in run["random_mean_m"].items()},
        **{name: [_round(v) for v in run["posterior_metrics"][name]] for name in ("credible_level", "entropy")},
        "levels": _list_levels(run), "coverage": run["posterior"]["coverage"],
        "times": [[stage, 1e3 * s] for stage, s in run["median_seconds"].items()],
    }  # fmt: skip


def _round(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


# ---- from several contacts


def _summarise_contacts(run: Run) -> tuple[str, str, str]:
    first, last = (run["lines"][CONTACTS_LINE][k] for k in (0, -1))
    medians = f"{format_mm(first['metres']['median'])} → {format_mm(last['metres']['median'])} mm"
    return run["name"], medians, f"median ADD from {_count_contacts(first)} to {_count_contacts(last)}"


def _tabulate_contacts(runs: Sequence[Run]) -> dict[str, Any]:
    rows = [
        [run["name"], line, *(f"{format_mm(e['metres']['median'])} ({e['normalised']['median']:.3f})" for e in entries)]
        for run in runs
        for line, entries in run["lines"].items()
    ]
    without = [[run["name"], *(entry["without_common"] for entry in run["lines"][CONTACTS_LINE])] for run in runs]
    return {
        "contacts": [_count_contacts(entry) for entry in runs[0]["lines"][CONTACTS_LINE]],
        "rows": rows,
        "without": without,
    }


def _count_contacts(entry: Mapping[str, Any]) -> str:
    return "1 contact" if entry["contacts"] == 1 else f"{entry['contacts']} contacts"


def _collect_quartiles(run: Run) -> dict[str, Any]:
    """Return the medians and quartiles of a run for the page's scripts, in mm and as shares."""
    lines = {
        line: {
            "contacts": [entry["contacts"] for entry in entries],
            **{
                unit: {key: [factor * entry[unit][key] for entry in entries] for key in ("median", "q25", "q75")}
                for unit, factor in UNITS.items()
            },
        }
        for line, entries in run["lines"].items()
    }
    return {"name": run["name"], "lines": lines}
