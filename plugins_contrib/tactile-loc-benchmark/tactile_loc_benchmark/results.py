"""The results of a benchmark, as its files state them: sources, methods, rows and failures."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

from tactile_loc_benchmark.job import Row
from tactile_loc_benchmark.suite import Suite
from tactile_loc_benchmark.summary import summarise


@dataclass(frozen=True)
class UsedSource:
    """A source of touches, or the `problem` why it was left out. `objects` are the names of its objects.

    `protocol` is a hash of everything that determines the touches.
    """

    label: str
    name: str
    protocol: str = ""
    licence: str = ""
    libraries: Mapping[str, str] = field(default_factory=dict)
    objects: Sequence[str] = ()
    recorded: bool = False
    problem: str = ""


@dataclass(frozen=True)
class UsedMethod:
    """A method, or the `problem` why it was left out. `paper` is the publication that it follows."""

    label: str
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    paper: str = ""
    libraries: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""


@dataclass(frozen=True, eq=False)
class Results:
    """The results of a suite.

    `rows` are in the order of sources, objects and methods. `failed` has the source, object, method and error of each
    job that ended with an error. `versions` are those of tactile-loc and its libraries, and `created` is the time in
    ISO format.
    """

    suite: Suite
    sources: Sequence[UsedSource]
    methods: Sequence[UsedMethod]
    rows: Sequence[Row]
    failed: Sequence[Mapping[str, str]]
    versions: Mapping[str, str]
    created: str

    @cached_property
    def groups(self) -> list[Row]:
        """The results of each source, method and number of touches."""
        return summarise(self.rows)

    @property
    def jobs(self) -> int:
        """The number of finished and failed jobs."""
        return len({(row["source"], row["object"], row["method"]) for row in self.rows}) + len(self.failed)

    @property
    def left_out(self) -> dict[str, str]:
        """The problems of the sources and methods that were not used, by label."""
        return find_problems([*self.sources, *self.methods])


def find_problems(entries: Sequence[UsedSource | UsedMethod]) -> dict[str, str]:
    """Return the problems of the sources and methods that cannot be used, by label."""
    return {one.label: one.problem for one in entries if one.problem}


def describe_used(entries: Sequence[UsedSource | UsedMethod]) -> dict[str, dict[str, Any]]:
    """Return the sources or methods without a problem as JSON values, by label."""
    described = {one.label: asdict(one) for one in entries if not one.problem}
    return {
        label: {key: value for key, value in values.items() if key not in ("label", "problem")}
        for label, values in described.items()
    }
