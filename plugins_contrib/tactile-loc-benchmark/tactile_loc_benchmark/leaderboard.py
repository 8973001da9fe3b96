"""Leaderboard files: results of a benchmark without poses and paths, to compare them with those of other people."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.plugin import ConfigError

from tactile_loc_benchmark.results import Results, describe_used
from tactile_loc_benchmark.summary import MethodResult

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Standing:
    """A group of a leaderboard file, with the date of the run.

    `protocol` is a hash of everything that determines the touches. Only groups with the same suite and protocol can be
    compared. `component` is the method's name, and `libraries` are the versions of the method's libraries.
    """

    suite: str
    summary: str
    protocol: str
    licence: str
    source_libraries: Mapping[str, str]
    component: str
    options: Mapping[str, Any]
    paper: str
    libraries: Mapping[str, str]
    date: str
    group: MethodResult


def record_leaderboard(results: Results) -> dict[str, Any]:
    """Return the suite, the sources and methods with their versions, and the groups, as JSON values."""
    return {
        "schema_version": SCHEMA_VERSION,
        "created": results.created,
        "versions": dict(results.versions),
        "suite": {"name": results.suite.name, "summary": results.suite.summary, **results.suite.describe_protocol()},
        "sources": describe_used(results.sources),
        "methods": describe_used(results.methods),
        "groups": [group.describe() for group in results.groups],
    }


def read_document(path: Path) -> dict[str, Any]:
    """Return a JSON file of a benchmark. Raises ConfigError if it cannot be read."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path} cannot be read ({error}); run the benchmark again") from error


def read_standings(path: Path) -> Iterator[Standing]:
    """Yield the groups of a leaderboard file. Raises ConfigError for a damaged file or one of another version."""
    document = read_document(path)
    if document.get("schema_version") != SCHEMA_VERSION:
        raise ConfigError(f"{path} has another version than {SCHEMA_VERSION}; run the benchmark again")
    try:
        for values in document["groups"]:
            group = MethodResult.read(values)
            source, method = document["sources"][group.source], document["methods"][group.method]
            yield Standing(
                suite=document["suite"]["name"],
                summary=document["suite"]["summary"],
                protocol=source["protocol"],
                licence=source["licence"],
                source_libraries=source["libraries"],
                component=method["name"],
                options=method["options"],
                paper=method["paper"],
                libraries=method["libraries"],
                date=document["created"][:10],
                group=group,
            )
    except (LookupError, TypeError) as error:
        raise ConfigError(f"{path} is damaged or incomplete ({error!r}); run the benchmark again") from error
