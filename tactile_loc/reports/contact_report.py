"""The report of an evaluation from several contacts: errors by their number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tactile_loc.evaluation.fusion_tables import SCHEMA_VERSION
from tactile_loc.evaluation.tabular import mm
from tactile_loc.reports.documents import guarded, named_runs, require_version, settings_details
from tactile_loc.reports.markup import choice, figure, table, tiles
from tactile_loc.reports.page import Page, Section
from tactile_loc.reports.source import Source

LINE = "best-1"
SCALES = {"metres": "mm", "normalised": "share of a random pose's mean"}


def contact_page(source: Source) -> Page:
    """Return the page of an evaluation from several contacts. Raises ResultError when its files cannot be used."""
    document = source.document()
    require_version(source, document, SCHEMA_VERSION)
    return guarded(source, lambda: _page(document))


def _page(document: dict[str, Any]) -> Page:
    runs = document["runs"]
    names = named_runs(runs)
    sections = [
        Section("summary", "", tiles(_tiles(document, names))),
        Section("curves", "Errors by the number of contacts", _curves(runs)),
        Section("medians", "Medians", _medians(runs, names)),
        Section("made", "Made with", settings_details(document, names)),
    ]
    data = {"runs": [_run(run, name) for run, name in zip(runs, names, strict=True)]}
    title = f"Several contacts: {', '.join(dict.fromkeys(run['object'] for run in runs))}"
    return Page(title, _about(document), sections, data, ["errors.js", "contacts.js"])


def _about(document: dict[str, Any]) -> str:
    protocol = document["protocol"]
    return (
        f"{protocol['examples']} simulated examples of each object, noise {protocol['noise']}, seed "
        f"{protocol['seed']}; protocol {protocol['version']}; {document['created']}"
    )


def _tiles(document: dict[str, Any], names: Sequence[str]) -> list[tuple[str, str, str]]:
    found = []
    for run, name in zip(document["runs"], names, strict=True):
        line = run["lines"][LINE]
        first, last = line[0], line[-1]
        medians = f"{mm(first['metres']['median'])} → {mm(last['metres']['median'])} mm"
        found.append(
            (name, medians, f"median ADD from {_contacts(first['contacts'])} to {_contacts(last['contacts'])}")
        )
    return found


def _curves(runs: Sequence[dict[str, Any]]) -> str:
    lines = list(runs[0]["lines"])
    choices = choice("line", "line", ["all", *lines], "all") + choice("scale", "in", SCALES)
    return f'<div class="choices">{choices}</div>' + figure(
        "curves",
        "Median ADD of the most probable pose, and the quartiles as a band; the axis is logarithmic. kinematic knows "
        "of contact only.",
        size="tall3d",
    )


def _medians(runs: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    numbers = [entry["contacts"] for entry in runs[0]["lines"][LINE]]
    rows = []
    for run, name in zip(runs, names, strict=True):
        for line, entries in run["lines"].items():
            cells = [f"{mm(e['metres']['median'])} ({e['normalised']['median']:.3f})" for e in entries]
            rows.append([name, line, *cells])
    without = [
        [name, *(entry["without_common"] for entry in run["lines"][LINE])]
        for run, name in zip(runs, names, strict=True)
    ]  # fmt: skip
    note = '<p class="note">median ADD in mm and, in brackets, as a share of a random pose\'s mean</p>'
    second = "<h3>examples in which no grid pose touches all sensors, located from the first contact alone</h3>"
    return (
        note + table(["object", "line", *(_contacts(n) for n in numbers)], rows, left=2, label="medians")
        + second + table(["object", *(_contacts(n) for n in numbers)], without, label="without a common pose")
    )  # fmt: skip


def _contacts(count: int) -> str:
    return "1 contact" if count == 1 else f"{count} contacts"


def _run(run: dict[str, Any], name: str) -> dict[str, Any]:
    """What scripts draw of a run: medians and quartiles, mm, or as shares."""
    lines = {
        line: {
            "contacts": [entry["contacts"] for entry in entries],
            **{unit: {key: [(1e3 if unit == "metres" else 1.0) * entry[unit][key] for entry in entries]
                      for key in ("median", "q25", "q75")} for unit in SCALES},
        }
        for line, entries in run["lines"].items()
    }  # fmt: skip
    return {"name": name, "lines": lines}
