"""Reports: HTML files, each of which shows one result. See docs/reports.md."""

from __future__ import annotations

from tactile_loc.reports.report import Source, find_source, write_report

__all__ = ["Source", "find_source", "write_report"]
