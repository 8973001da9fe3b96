"""Leaderboard files: results of a benchmark without poses and paths, to compare them with those of other people."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tactile_loc.plugin import ConfigError

from tactile_loc_benchmark.job import Row
from tactile_loc_benchmark.results import Results, describe_used

SCHEMA_VERSION = 2
ABOUT_SOURCE, ABOUT_METHOD = ("protocol", "licence"), ("options", "paper", "libraries")


def record_leaderboard(results: Results) -> dict[str, Any]:
    """Return the suite, the sources and methods with their versions, and the groups, as JSON values."""
    return {
        "schema_version": SCHEMA_VERSION,
        "created": results.created,
        "versions": dict(results.versions),
        "suite": {"name": results.suite.name, "summary": results.suite.summary, **results.suite.describe_protocol()},
        "sources": describe_used(results.sources),
        "methods": describe_used(results.methods),
        "groups": results.groups,
    }


def read_document(path: Path) -> dict[str, Any]:
    """Return a JSON file of a benchmark. Raises ConfigError if it cannot be read, or has another version."""
    try:
        document = dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"{path} cannot be read ({error}); run the benchmark again") from error
    if document.get("schema_version") != SCHEMA_VERSION:
        raise ConfigError(f"{path} has another version than {SCHEMA_VERSION}; run the benchmark again")
    return document


def read_standings(path: Path) -> Iterator[Row]:
    """Yield the groups of a leaderboard file, with what it states about the suite, the source and the method.

    Groups are the rows of `summary.summarise`. Further values are the `suite`, its `summary`, the `date` of the run,
    the `protocol`, a hash of everything that determines the touches, the `licence` and `source_libraries` of the
    source, and the `component`, `options`, `paper` and `libraries` of the method. Only groups with the same suite and
    protocol can be compared. Raises ConfigError for a damaged file or one of another version.
    """
    document = read_document(path)
    try:
        for group in document["groups"]:
            source, method = document["sources"][group["source"]], document["methods"][group["method"]]
            yield {
                **group,
                "suite": document["suite"]["name"],
                "summary": document["suite"]["summary"],
                "date": document["created"][:10],
                "source_libraries": source["libraries"],
                "component": method["name"],
                **{name: source[name] for name in ABOUT_SOURCE},
                **{name: method[name] for name in ABOUT_METHOD},
            }
    except (LookupError, TypeError) as error:
        raise ConfigError(f"{path} is damaged or incomplete ({error!r}); run the benchmark again") from error
