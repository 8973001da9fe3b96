"""A report of any result: find out what it is, make its page, write it."""

from __future__ import annotations

from pathlib import Path

from tactile_loc.reports.page import Page, render
from tactile_loc.reports.source import Source
from tactile_loc.store.files import write_atomically

DEFAULT_NAME = "report.html"


def page_of(source: Source) -> Page:
    """Return the page of a result. Raises ResultError when it cannot be read."""
    if source.kind == "run":
        from tactile_loc.locate.result_files import NAME, read_arrays
        from tactile_loc.reports.run_report import read_record, run_page

        record = read_record(source)
        return run_page(record, read_arrays(source.folder / NAME, record))
    if source.kind == "sweep":
        from tactile_loc.reports.sweep_report import sweep_page

        return sweep_page(source)
    if source.kind == "contacts":
        from tactile_loc.reports.contact_report import contact_page

        return contact_page(source)
    from tactile_loc.reports.evaluation_report import evaluation_page

    return evaluation_page(source)


def write_report(source: Source, out: Path | None = None) -> Path:
    """Write the report of a result, beside it unless `out` says where, and return its path.

    Raises ResultError when the result cannot be read, OutputError when the report cannot be written.
    """
    path = source.folder / DEFAULT_NAME if out is None else out
    html = render(page_of(source))
    return write_atomically(path, lambda temporary: temporary.write_text(html, encoding="utf-8"))
