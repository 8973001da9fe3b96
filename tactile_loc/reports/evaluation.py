"""The reports of evaluations: from one touch, and from several contacts by their number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.errors import ResultError
from tactile_loc.core.formatting import mm
from tactile_loc.evaluation import fusion_tables, tables
from tactile_loc.evaluation.posterior_metrics import LEVELS
from tactile_loc.io.records import read_document
from tactile_loc.io.toml import format_toml
from tactile_loc.reports.page import Page, Section, damage_named, require_finite
from tactile_loc.reports.pictures import gallery_picture

METRIC_NAMES = {"add": "ADD", "mssd": "MSSD", "add-s": "ADD-S"}
FIRST_LINE = "chosen"  # what the curves begin with, if the evaluation has it
CONTACTS_LINE = "best-1"  # whose medians head the page of several contacts
UNITS = {"metres": 1e3, "normalised": 1.0}  # of statistics, and what they are multiplied by to be drawn: mm, shares
DIGITS = 6

Run = Mapping[str, Any]


def evaluation_page(path: Path) -> Page:
    """Return the page of an evaluation, given its results.json. Raises ResultError when its files cannot be used."""
    document = _read(path, tables.SCHEMA_VERSION)
    with damage_named(path):
        return require_finite(_evaluation(path.parent, document))


def contacts_page(path: Path) -> Page:
    """Return the page of an evaluation from several contacts, given its contacts.json. Raises ResultError."""
    document = _read(path, fusion_tables.SCHEMA_VERSION)
    with damage_named(path):
        return require_finite(_contacts(document))


def _read(path: Path, version: int) -> dict[str, Any]:
    document = read_document(path)
    found = document.get("schema_version")
    if found != version:
        raise ResultError(f"{path} is of version {found}, and this tactile-loc reads version {version}; make it again")
    return document


def _names(runs: Sequence[Run]) -> list[str]:
    """A name for each run: its object's, with the encoder's where there are several."""
    if not runs:
        raise ValueError("it holds no run")
    several = len({run["encoder"] for run in runs}) > 1
    return [f"{run['object']}, {run['encoder']}" if several else str(run["object"]) for run in runs]


def _made(document: Mapping[str, Any], names: Sequence[str]) -> Section:
    """Every run's object and configuration, and the versions."""
    runs = [
        (
            name,
            f"{name}: {run['grid_poses']} grid poses, symmetry {run['symmetry']}, encoder {run['encoder']}",
            format_toml(run.get("configuration", {})),
        )
        for run, name in zip(document["runs"], names, strict=True)
    ]
    return Section("made", "Made with", {"runs": runs, "versions": list(document["versions"].items())})


# ---- from one touch


def _evaluation(folder: Path, document: dict[str, Any]) -> Page:
    runs = document["runs"]
    names = _names(runs)
    lines, metrics = list(runs[0]["errors_m"]), list(next(iter(runs[0]["errors_m"].values())))
    sections = [
        Section("summary", "", {"numbers": _numbers(runs, _first(lines))}),
        Section("medians", "Medians", _medians(runs, names)),
        Section("errors", "Errors", _choices(names, lines, metrics)),
        Section("posterior", "Can the probabilities be trusted?", _posterior(runs, names)),
        Section("times", "Times", _times(runs, names)),
        Section("gallery", "Best, median and worst touches", {"pictures": _gallery(folder, runs)}),
        _made(document, names),
    ]
    shown = [section for section in sections if section.values.get("pictures", True)]
    data = {"runs": [_drawn(run, name) for run, name in zip(runs, names, strict=True)], "lines": lines}
    scripts = ["errors.js", "evaluation.js"]
    return Page("evaluation", f"Evaluation: {_objects(runs)}", _about(document), shown, data, scripts)


def _objects(runs: Sequence[Run]) -> str:
    found = list(dict.fromkeys(run["object"] for run in runs))
    return ", ".join(found) if len(found) < 7 else f"{len(found)} objects"


def _about(document: Mapping[str, Any]) -> str:
    protocol = document["protocol"]
    kind = "simulated images" if protocol.get("images") else "simulated touches"
    return (
        f"{protocol['touches']} {kind} of each object, noise {protocol['noise']}, seed {protocol['seed']}; "
        f"protocol {protocol['version']}; {document['created']}"
    )


def _first(lines: Sequence[str]) -> str:
    return FIRST_LINE if FIRST_LINE in lines else lines[0]


def _numbers(runs: Sequence[Run], line: str) -> list[tuple[str, str, str]]:
    medians = [run["lines"][line]["add"] for run in runs]
    ambiguous = float(np.mean([run["ambiguity"]["ambiguous"] for run in runs]))
    middle_mm = mm(float(np.median([m["metres"]["median"] for m in medians])))
    share = float(np.median([m["normalised"]["median"] for m in medians]))
    covered = np.mean([run["posterior"]["coverage"] for run in runs], axis=0)
    of_all = f"the median of {len(runs)} medians" if len(runs) > 1 else f"of {runs[0]['object']}"
    sets = [
        (_set_name(level), f"{100 * held:.0f} %", f"of the true poses; right would be {100 * level:.0f} %")
        for level, held in zip(_levels(runs[0]), covered, strict=True)
    ]
    return [
        (f"median ADD, {line}", f"{middle_mm} mm", of_all),
        ("of a random pose's mean", f"{share:.3f}", "the same, as a share"),
        ("ambiguous", f"{100 * ambiguous:.0f} %", "of the touches: a distant pose makes that contact, within noise"),
        *sets,
    ]


def _levels(run: Run) -> list[float]:
    return list(run["posterior"].get("levels", LEVELS))


def _set_name(level: float) -> str:
    return f"in the {100 * level:.0f} % set"


def _medians(runs: Sequence[Run], names: Sequence[str]) -> dict[str, Any]:
    lines = [line for line in tables.SHOWN if line in runs[0]["lines"]]
    lengths, shares = (
        [[name, run["grid_poses"], *(write(run["lines"][line]["add"][unit]["median"]) for line in lines)]
         for run, name in zip(runs, names, strict=True)]
        for unit, write in (("metres", mm), ("normalised", "{:.3f}".format))
    )  # fmt: skip
    return {"header": ["object", "grid poses", *lines], "lengths": lengths, "shares": shares}


def _choices(names: Sequence[str], lines: Sequence[str], metrics: Sequence[str]) -> dict[str, Any]:
    """What can be chosen for the plots of errors."""
    objects = {"": "all, by line", **{str(i): name for i, name in enumerate(names)}}
    return {
        "objects": objects if len(names) > 1 else {"0": names[0]},
        "metrics": {metric: METRIC_NAMES.get(metric, metric) for metric in metrics},
        "lines": lines,
        "first": _first(lines),
    }


def _posterior(runs: Sequence[Run], names: Sequence[str]) -> dict[str, Any]:
    header = ["object", *map(_set_name, _levels(runs[0])), "NLL (nats)", "of knowing nothing", "entropy (nats)",
              "expected error (mm)", "spread (mm)"]  # fmt: skip
    rows = []
    for run, name in zip(runs, names, strict=True):
        posterior = run["posterior"]
        held = [f"{100 * share:.0f} %" for share in posterior["coverage"]]
        nats = [f"{posterior[key]:.2f}" for key in ("nll", "uniform_nll", "entropy")]
        rows.append([name, *held, *nats, mm(posterior["expected_error_m"]), mm(posterior["spread_m"])])
    return {"header": header, "rows": rows}


def _times(runs: Sequence[Run], names: Sequence[str]) -> dict[str, Any]:
    stages = list(runs[0]["median_seconds"])
    rows = [[name, *(f"{1e3 * run['median_seconds'][stage]:.2f}" for stage in stages)]
            for run, name in zip(runs, names, strict=True)]  # fmt: skip
    return {"header": ["object", *(f"{stage} (ms)" for stage in stages)], "rows": rows}


def _gallery(folder: Path, runs: Sequence[Run]) -> list[tuple[str, str]]:
    """What each picture shows, and the picture: those of the folder alone, whatever a run calls itself."""
    found = []
    for run in runs:
        path = folder / f"gallery-{run['object']}-{run['encoder']}.png"
        uri = gallery_picture(path) if path.parent == folder else None
        if uri is not None:
            found.append((f"touches of {run['object']} with {run['encoder']}", uri))
    return found


def _drawn(run: Run, name: str) -> dict[str, Any]:
    """What scripts draw of a run; mm, nats, ms."""
    errors = {
        line: {metric: [_short(1e3 * e) for e in values] for metric, values in by_metric.items()}
        for line, by_metric in run["errors_m"].items()
    }
    return {
        "name": name, "errors_mm": errors, "random_mm": {m: 1e3 * v for m, v in run["random_mean_m"].items()},
        **{name: [_short(v) for v in run["posterior_metrics"][name]] for name in ("credible_level", "entropy")},
        "levels": _levels(run), "coverage": run["posterior"]["coverage"],
        "times": [[stage, 1e3 * s] for stage, s in run["median_seconds"].items()],
    }  # fmt: skip


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


# ---- from several contacts


def _contacts(document: dict[str, Any]) -> Page:
    runs = document["runs"]
    names = _names(runs)
    sections = [
        Section("summary", "", {"numbers": _contact_numbers(runs, names)}),
        Section("curves", "Errors by the number of contacts", {"lines": ["all", *runs[0]["lines"]]}),
        Section("medians", "Medians", _contact_medians(runs, names)),
        _made(document, names),
    ]
    protocol = document["protocol"]
    about = (
        f"{protocol['examples']} simulated examples of each object, noise {protocol['noise']}, seed "
        f"{protocol['seed']}; protocol {protocol['version']}; {document['created']}"
    )
    data = {"runs": [_drawn_contacts(run, name) for run, name in zip(runs, names, strict=True)]}
    title = f"Several contacts: {', '.join(dict.fromkeys(run['object'] for run in runs))}"
    return Page("contacts", title, about, sections, data, ["errors.js", "contacts.js"])


def _contact_numbers(runs: Sequence[Run], names: Sequence[str]) -> list[tuple[str, str, str]]:
    found = []
    for run, name in zip(runs, names, strict=True):
        line = run["lines"][CONTACTS_LINE]
        medians = f"{mm(line[0]['metres']['median'])} → {mm(line[-1]['metres']['median'])} mm"
        found.append((name, medians, f"median ADD from {_count(line[0])} to {_count(line[-1])}"))
    return found


def _contact_medians(runs: Sequence[Run], names: Sequence[str]) -> dict[str, Any]:
    rows = [
        [name, line, *(f"{mm(e['metres']['median'])} ({e['normalised']['median']:.3f})" for e in entries)]
        for run, name in zip(runs, names, strict=True)
        for line, entries in run["lines"].items()
    ]
    without = [
        [name, *(entry["without_common"] for entry in run["lines"][CONTACTS_LINE])]
        for run, name in zip(runs, names, strict=True)
    ]
    return {"contacts": [_count(entry) for entry in runs[0]["lines"][CONTACTS_LINE]], "rows": rows, "without": without}


def _count(entry: Mapping[str, Any]) -> str:
    return "1 contact" if entry["contacts"] == 1 else f"{entry['contacts']} contacts"


def _drawn_contacts(run: Run, name: str) -> dict[str, Any]:
    """What scripts draw of a run: medians and quartiles, mm, or as shares."""
    lines = {
        line: {"contacts": [entry["contacts"] for entry in entries], **_quartiles(entries)}
        for line, entries in run["lines"].items()
    }
    return {"name": name, "lines": lines}


def _quartiles(entries: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, list[float]]]:
    return {
        unit: {key: [factor * entry[unit][key] for entry in entries] for key in ("median", "q25", "q75")}
        for unit, factor in UNITS.items()
    }
