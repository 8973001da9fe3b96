"""Reports: HTML files, each of which shows one result. See docs/reports.md."""

from tactile_loc.reports.report import find_result, write_report

__all__ = ["find_result", "write_report"]
