"""What the store holds, in words: what each stage was made from, how old it is, and which of them are to go."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from tactile_loc.core.errors import ConfigError, StoreError
from tactile_loc.core.slots.registry import SLOTS
from tactile_loc.store.artifact import read_artifact
from tactile_loc.store.store import Entry

UNITS_S = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_DURATION = re.compile(r"(\d+(?:\.\d+)?)([smhdw])")
LABEL = "label"  # of a stage, beside its inputs
_DIGEST = re.compile(r"[0-9a-f]{64}")


def parse_age(text: str) -> timedelta:
    """Return the duration that a text such as "30d" or "1.5h" names. Raises ConfigError."""
    match = _DURATION.fullmatch(text.strip().lower())
    try:
        if match:
            return timedelta(seconds=float(match[1]) * UNITS_S[match[2]])
    except OverflowError:
        pass
    raise ConfigError(f"--older-than {text!r} is no age; write a number and s, m, h, d or w, such as 30d or 12h")


def age_in_words(seconds: float) -> str:
    """Return an age in the largest unit of which it holds two, such as 45 min, 3 h, 12 d."""
    for unit, name in (("d", "d"), ("h", "h"), ("m", "min")):
        if seconds >= 2 * UNITS_S[unit]:
            return f"{seconds / UNITS_S[unit]:.0f} {name}"
    return f"{max(seconds, 0):.0f} s"


def age_s(entry: Entry, now: datetime | None = None) -> float:
    """Return how long ago an entry was built, or last worked at, seconds."""
    return ((now or datetime.now(UTC)) - entry.created).total_seconds()


@dataclass(frozen=True)
class Criteria:
    """Which entries to remove: those that meet all that is asked."""

    everything: bool = False
    stages: tuple[str, ...] = ()
    older_than: timedelta | None = None
    incomplete: bool = False
    keep_newest: int = 0

    def __post_init__(self) -> None:
        if not (self.everything or self._some):
            raise ConfigError(
                "say what to remove: --older-than 30d, --stage NAME, --incomplete, --keep-newest N, or --all"
            )
        if self.everything and self._some:
            raise ConfigError("--all removes everything: leave it out, or the other conditions")

    @property
    def _some(self) -> bool:
        return bool(self.stages or self.older_than is not None or self.incomplete or self.keep_newest)

    def choose(self, entries: Sequence[Entry]) -> list[Entry]:
        """Return the entries to remove, in their order. Raises ConfigError for a stage that the store does not hold."""
        known = {entry.stage for entry in entries}
        if unknown := [stage for stage in self.stages if stage not in known]:
            raise ConfigError(
                f"the store holds no stage {unknown[0]!r}; it holds {', '.join(sorted(known)) or 'nothing'}"
            )
        kept, now = set(self._newest(entries)), datetime.now(UTC)
        return [entry for entry in entries if entry.path not in kept and self._is_met(entry, now)]

    def _is_met(self, entry: Entry, now: datetime) -> bool:
        return (
            (not self.stages or entry.stage in self.stages)
            and (self.older_than is None or age_s(entry, now) > self.older_than.total_seconds())
            and not (self.incomplete and entry.complete)
        )

    def _newest(self, entries: Sequence[Entry]) -> Iterator[Any]:
        """The paths of the newest finished entries of each stage."""
        for group in by_stage(entries).values():
            finished = sorted((e for e in group if e.complete), key=lambda e: e.created, reverse=True)
            yield from (entry.path for entry in finished[: self.keep_newest])


def by_stage(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """Return the entries of each stage."""
    groups: defaultdict[str, list[Entry]] = defaultdict(list)
    for entry in entries:
        groups[entry.stage].append(entry)
    return dict(groups)


@dataclass
class Origins:
    """What the entries of a store were made from, by their manifests and those of the stages they refer to."""

    entries: Sequence[Entry]
    _inputs: dict[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for entry in self.entries:
            if entry.complete and (inputs := _inputs(entry)) is not None:
                self._inputs[entry.digest] = inputs

    def is_readable(self, entry: Entry) -> bool:
        """Whether the entry is finished and its manifest is whole; the files' checksums are not looked at."""
        return entry.digest in self._inputs

    def of(self, entry: Entry) -> dict[str, str]:
        """Return what an entry was made from: "object" (its name, or its mesh's digest), and components by slot."""
        parts = dict(_parts(self._inputs.get(entry.digest, {}), self._inputs, _names(), frozenset({entry.digest})))
        return {key: parts[key] for key in ("object", *SLOTS) if key in parts}


def _inputs(entry: Entry) -> Mapping[str, Any] | None:
    try:
        key = read_artifact(entry.path).key
    except StoreError:
        return None
    return {**key.inputs, LABEL: key.label}


def _parts(
    value: Any, known: Mapping[str, Mapping[str, Any]], names: Mapping[str, tuple[str, str]], seen: frozenset[str]
) -> Iterator[tuple[str, str]]:
    """What inputs name, those of the stages they refer to first."""
    if isinstance(value, str) and _DIGEST.fullmatch(value):
        if (digest := value[:16]) in known and digest not in seen:
            yield from _parts(known[digest], known, names, seen | {digest})
    elif isinstance(value, Mapping):
        if "mesh" in value and "symmetry" in value:
            yield "object", f"mesh {str(value['mesh'])[:8]} ({value['symmetry']})"
        elif value.get("class") in names:
            yield names[value["class"]]
        for item in value.values():
            yield from _parts(item, known, names, seen)
        if value.get(LABEL):
            yield "object", value[LABEL]


def _names() -> dict[str, tuple[str, str]]:
    """Slot and name of each component, by what its description calls its class."""
    from tactile_loc.core.slots.registry import registry

    return {c.spec.target: (c.spec.slot, c.spec.name) for c in registry().components}
