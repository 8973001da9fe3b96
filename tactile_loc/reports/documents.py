"""What pages of evaluations share: reading their JSON, naming their runs, and what they were made with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tactile_loc.io.toml import toml_text
from tactile_loc.reports.markup import details, escape, preformatted, script_json, versions_table
from tactile_loc.reports.page import Page
from tactile_loc.reports.source import ResultError, Source


def require_version(source: Source, document: Mapping[str, Any], version: int) -> None:
    """Raise ResultError when a document is of another version than the one that is read."""
    found = document.get("schema_version")
    if found != version:
        raise ResultError(
            f"{source.path} is of version {found}, and this tactile-loc reads version {version}; make it again"
        )


def guarded(source: Source, make: Callable[[], Page]) -> Page:
    """Make a page of a document; what is missing in it is one sentence. Raises ResultError."""
    try:
        page = make()
        script_json(page.data)  # raises where a number is not finite
        return page
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, StopIteration) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise ResultError(f"{source.path} is damaged or incomplete: {reason}; make the result again") from error


def named_runs(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a name for each run: its object's, with the encoder's where there are several."""
    if not runs:
        raise ValueError("it holds no run")
    several = len({run["encoder"] for run in runs}) > 1
    return [f"{run['object']}, {run['encoder']}" if several else str(run["object"]) for run in runs]


def settings_details(document: Mapping[str, Any], names: Sequence[str]) -> str:
    """Return every run's object and configuration, and the versions, to be opened."""
    parts = []
    for run, name in zip(document["runs"], names, strict=True):
        about = f"{name}: {run['grid_poses']} grid poses, symmetry {run['symmetry']}, encoder {run['encoder']}"
        parts.append(details(f"configuration of {name}", f"<p>{escape(about)}</p>" + _settings(run)))
    return "".join(parts) + details("versions", versions_table(document["versions"]))


def _settings(run: Mapping[str, Any]) -> str:
    return preformatted(toml_text(run.get("configuration", {})))
