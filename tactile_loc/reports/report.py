"""The report of any result: find the result, make its page, and write the page."""

import json
import os
from pathlib import Path

from tactile_loc.core.runtime.errors import OutputError, ResultError
from tactile_loc.reports.page import JSON_OPTIONS, Page, name_damage, render
from tactile_loc.store.files import write_atomically

KINDS = {"result": "run", "recall": "recall", "sweep": "sweep"}
BENCHMARK = "benchmark.json"  # a result of the package tactile-loc-benchmark
SUFFIXES = (".json", ".npz", ".csv", ".md", ".png")
DEFAULT_NAME = "report.html"


def find_result(path: Path) -> Path:
    """Return the JSON file of the result in a folder, or of the result that a file belongs to.

    Raises ResultError if there is no result, or more than one.
    """
    folder = path if os.path.isdir(path) else path.parent
    if (folder / BENCHMARK).is_file() and path in (folder, folder / BENCHMARK):
        command = f"tactile-loc benchmark --report --out {folder}"
        raise ResultError(f"{path} is the result of a benchmark; write its page with {command}")
    if os.path.isdir(path):
        return _find_in_folder(path)
    if path.stem not in KINDS or path.suffix not in SUFFIXES:
        fault = f"{path} is not a result" if os.path.exists(path) else f"there is no file or folder {path}"
        raise ResultError(f"{fault}; give the folder that run, evaluate or sweep wrote, or its {_list_names()}")
    document = path.with_suffix(".json")
    if not os.path.isfile(document):
        raise ResultError(f"there is no file {document}; give the folder that run, evaluate or sweep wrote")
    return document


def make_page(document: Path) -> Page:
    """Return the page of the result in a JSON file. Raises ResultError if the result's files cannot be used."""
    from tactile_loc.reports import evaluation, run, sweep

    makers = {"run": run.make_run_page, "recall": evaluation.make_recall_page, "sweep": sweep.make_sweep_page}
    with name_damage(document):
        page = makers[KINDS[document.stem]](document)
        json.dumps(page.data, **JSON_OPTIONS)  # raises for a number that is not finite
    return page


def write_report(result: str | Path, out: Path | None = None) -> Path:
    """Write the report of the result in a file or folder to `out`, by default beside it, and return the path.

    Raises ResultError if the result cannot be read, and OutputError if the report cannot be written.
    """
    document = find_result(Path(result))
    path = choose_path(document.parent, out)
    with name_damage(document):
        return write_page(make_page(document), path)


def choose_path(folder: Path, out: Path | None) -> Path:
    """Return the path `out` of a page, by default in the folder. Raises OutputError if it does not end in .html."""
    path = folder / DEFAULT_NAME if out is None else out
    if path.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"`out` {path.name} must end in .html; choose another name")
    return path


def write_page(page: Page, path: Path) -> Path:
    """Write a page atomically as one HTML file, and return the path.

    Raises OutputError if the file cannot be written.
    """
    html = render(page).encode(errors="backslashreplace")
    return write_atomically(path, lambda temporary: temporary.write_bytes(html))


def _find_in_folder(folder: Path) -> Path:
    found = [path for name in KINDS if (path := folder / f"{name}.json").is_file()]
    if not found:
        of_touches = (folder / "results.csv").is_file()
        advice = "the folder of one of its touches" if of_touches else "the folder that run, evaluate or sweep wrote"
        raise ResultError(f"{folder} contains no result ({_list_names()}); give {advice}")
    if len(found) > 1:
        names = " and ".join(path.name for path in found)
        raise ResultError(f"{folder} contains several results, {names}; give one of these files")
    return found[0]


def _list_names() -> str:
    *others, last = (f"{name}.json" for name in KINDS)
    return f"{', '.join(others)} or {last}"
