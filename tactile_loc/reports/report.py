"""A report of any result: find out what a path names, make its page, write it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from tactile_loc.core.errors import OutputError, ResultError
from tactile_loc.reports.page import Page, damage_named, render
from tactile_loc.store.files import write_atomically

KINDS = {"result": "run", "results": "evaluation", "contacts": "contacts", "sweep": "sweep"}
SUFFIXES = (".json", ".npz", ".csv", ".md", ".png")
DEFAULT_NAME = "report.html"


@dataclass(frozen=True)
class Source:
    """A result on disk: its kind, one of KINDS' values, and its JSON file."""

    kind: str
    path: Path

    @property
    def folder(self) -> Path:
        """The folder that holds the result."""
        return self.path.parent


def find_source(path: Path) -> Source:
    """Return the result that a path names: its folder, or one of its files. Raises ResultError if it names none."""
    if os.path.isdir(path):
        return _in_folder(path)
    kind = KINDS.get(path.stem) if path.suffix in SUFFIXES else None
    if kind is None:
        what = "is no result" if os.path.exists(path) else "does not exist"
        raise ResultError(f"{path} {what}; give the folder that run, evaluate or sweep wrote, or its {_names()}")
    document = path.with_suffix(".json")
    if not os.path.isfile(document):
        raise ResultError(f"there is no {document}; give the folder that run, evaluate or sweep wrote")
    return Source(kind, document)


def page_of(source: Source) -> Page:
    """Return the page of a result. Raises ResultError when its files cannot be used."""
    from tactile_loc.reports import evaluation, run, sweep

    kinds = {
        "run": run.read_page, "evaluation": evaluation.evaluation_page, "contacts": evaluation.contacts_page,
        "sweep": sweep.sweep_page,
    }  # fmt: skip
    return kinds[source.kind](source.path)


def write_report(source: Source, out: Path | None = None) -> Path:
    """Write the report of a result, beside it unless `out` says where, and return its path.

    Raises ResultError when the result cannot be read, OutputError when the report cannot be written.
    """
    path = source.folder / DEFAULT_NAME if out is None else out
    if path.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"a report is written as .html, not as {path.name}; choose another --out")
    with damage_named(source.path):
        return write_page(page_of(source), path)


def write_page(page: Page, path: Path) -> Path:
    """Write a page as one HTML file, atomically, and return its path. Raises OutputError."""
    html = render(page).encode(errors="backslashreplace")
    return write_atomically(path, lambda temporary: temporary.write_bytes(html))


def _in_folder(folder: Path) -> Source:
    found = [Source(kind, folder / f"{name}.json") for name, kind in KINDS.items()]
    found = [source for source in found if source.path.is_file()]
    if not found:
        hint = ""
        if (folder / "results.csv").is_file():
            hint = "; of a folder of touches, give the folder of one"
        raise ResultError(f"{folder} holds no result: none of {_names()}{hint}")
    if len(found) > 1:
        names = " and ".join(source.path.name for source in found)
        raise ResultError(f"{folder} holds several results, {names}; give one of these files")
    return found[0]


def _names() -> str:
    return ", ".join(f"{name}.json" for name in KINDS)
