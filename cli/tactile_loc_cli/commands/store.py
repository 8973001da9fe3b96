"""`tactile-loc store`: list, measure or prune the store of built stages."""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import chain, repeat
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.runtime.errors import ConfigError, StoreError, advise_choice
from tactile_loc.core.runtime.formatting import format_bytes
from tactile_loc.slots.registry import SLOTS, registry
from tactile_loc_cli.console import format_count, say, say_table
from tactile_loc_cli.options import Store, declare

if TYPE_CHECKING:
    from tactile_loc.store.store import Entry, StageStore

UNITS_S = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_DURATION = re.compile(r"(\d+(?:\.\d+)?)([smhdw])")
UNKNOWN = "unknown"  # object of interrupted and damaged entries
LABEL = "label"  # key under which a stage's label is added to its inputs
_DIGEST = re.compile(r"[0-9a-f]{64}")


application = typer.Typer()


@application.command("list")
def list_store(store: Store = None) -> dict[str, Any]:
    """List the stages in the store by object, the newest last.

    Each line shows the stage's digest, size, age, state, and the components that it was made from.
    """
    place = _open(store)
    entries = sorted(place.entries(), key=lambda entry: entry.created)
    origins = Origins(entries)
    rows = [_describe(place, entry, origins) for entry in entries]
    if rows:
        shown = [line for name, group in group_by_object(rows).items() for line in _write_group(name, group)]
        say_table([["object", "stage", "digest", "size", "age", "state", "made from"], *shown], left=(0, 1, 2, 5, 6))
    say(f"{_summarise(entries)} in {place.root}")
    return {"store": str(place.root), "entries": rows, "bytes": _sum_bytes(entries)}


def group_by_object(rows: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return rows grouped by object, in their order. The object whose last row comes last is the last group."""
    names = [row["made_from"].get("object", UNKNOWN) for row in rows]
    last = {name: place for place, name in enumerate(names)}
    return {
        name: [row for row, of in zip(rows, names, strict=True) if of == name]
        for name in sorted(last, key=lambda name: last[name])
    }


def _write_group(name: str, rows: Sequence[dict[str, Any]]) -> Iterator[list[str]]:
    """Yield the table's line of each entry of an object. Only the first line names the object."""
    for first, r in zip(chain([name], repeat("")), rows, strict=False):
        components = [made for part, made in r["made_from"].items() if part != "object"]
        yield [
            first,
            r["stage"],
            r["digest"],
            format_bytes(r["bytes"]),
            write_age(r["age_s"]),
            r["state"],
            ", ".join(components),
        ]


@application.command()
def size(store: Store = None) -> dict[str, Any]:
    """Show the size of the store by stage."""
    place = _open(store)
    entries = place.entries()
    stages = {
        stage: {
            "entries": len(group),
            "incomplete": sum(not entry.complete for entry in group),
            "bytes": _sum_bytes(group),
        }
        for stage, group in group_by_stage(entries).items()
    }
    if stages:
        shown = [
            [stage, *map(str, (s["entries"], s["incomplete"])), format_bytes(s["bytes"])] for stage, s in stages.items()
        ]
        say_table([["stage", "entries", "incomplete", "size"], *shown], left=1)
    say(f"{_summarise(entries)} in {place.root}")
    return {"store": str(place.root), "stages": stages, "entries": len(entries), "bytes": _sum_bytes(entries)}


@application.command()
def prune(
    criteria: Criteria,
    dry_run: Annotated[bool, declare("--dry-run", "List the entries without removing them.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask for confirmation.")] = False,
    store: Store = None,
) -> dict[str, Any]:
    """Remove entries from the store.

    With several conditions, only entries that meet all conditions are removed. Entries being built are kept. If a
    removed entry is needed later, it is built again.
    """
    place = _open(store)
    chosen = criteria.choose(place.entries())
    busy = [entry for entry in chosen if place.is_being_built(entry)]
    free = [entry for entry in chosen if entry not in busy]
    for entry in busy:
        say(f"kept, because it is being built: {_name(entry)}")
    if free and not (dry_run or yes or _is_confirmed(free)):
        free = []
    removed, kept = (free, []) if dry_run else _remove(place, free)
    _say_removed(place, removed, dry_run)
    record = {"removed": _record(removed), "left_alone": _record([*busy, *kept])}
    return {"store": str(place.root), "dry_run": dry_run, **record, "bytes": _sum_bytes(removed)}


def _open(store: Store) -> StageStore:
    """Open the store. Raises StoreError if its path is not a folder; only the default folder may be missing."""
    from tactile_loc.store.store import StageStore

    found = StageStore(store)
    if not found.root.is_dir() and (store is not None or found.root.exists()):
        raise StoreError(f"there is no store at {found.root}; check --store")
    return found


def _describe(place: StageStore, entry: Entry, origins: Origins) -> dict[str, Any]:
    if entry.complete:
        state = "complete" if origins.is_readable(entry) else "damaged"
    else:
        state = "being built" if _is_being_built(place, entry) else "interrupted"
    return {
        "stage": entry.stage,
        "digest": entry.digest,
        "bytes": entry.nbytes,
        "created": entry.created.isoformat(),
        "age_s": measure_age_s(entry),
        "complete": entry.complete,
        "state": state,
        "made_from": origins.find(entry),
    }


def _is_being_built(place: StageStore, entry: Entry) -> bool:
    """Return whether the entry is being built; False if this cannot be found out, as in a read-only store."""
    try:
        return place.is_being_built(entry)
    except StoreError:
        return False


def _is_confirmed(entries: Sequence[Entry]) -> bool:
    """Ask for confirmation. Raises ConfigError if stdin is not a terminal."""
    if not _is_terminal():
        raise ConfigError(
            "the removal needs a confirmation; give --yes, or --dry-run to list the entries without removing them"
        )
    return typer.confirm(f"Remove {_summarise(entries)}?", err=True)


def _is_terminal() -> bool:
    """Return whether stdin is a terminal, on which a user can answer."""
    return sys.stdin.isatty()


def _remove(place: StageStore, entries: Sequence[Entry]) -> tuple[list[Entry], list[Entry]]:
    """Remove entries. Return the removed entries, and the entries that another process has begun to build."""
    gone, kept = [], []
    for entry in entries:
        try:
            place.remove(entry.digest)
        except StoreError:
            if not place.is_being_built(entry):
                raise
            kept.append(entry)
            say(f"kept, because it is being built: {_name(entry)}")
        else:
            gone.append(entry)
    return gone, kept


def _say_removed(place: StageStore, entries: Sequence[Entry], dry_run: bool) -> None:
    for entry in entries:
        say(f"{'would remove' if dry_run else 'removed'} {_name(entry)}, {format_bytes(entry.nbytes)}")
    verb = "would be removed" if dry_run else "removed"
    say(f"{_summarise(entries)}, {verb} from {place.root}")


def _record(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    return [{"stage": entry.stage, "digest": entry.digest, "bytes": entry.nbytes} for entry in entries]


def _name(entry: Entry) -> str:
    return f"{entry.stage} {entry.digest}"


def _sum_bytes(entries: Sequence[Entry]) -> int:
    return sum(entry.nbytes for entry in entries)


def _summarise(entries: Sequence[Entry]) -> str:
    return f"{format_count(len(entries), 'entry')}, {format_bytes(_sum_bytes(entries))}"


def parse_age(text: str) -> timedelta:
    """Return the duration in a text such as "30d" or "1.5h". Raises ConfigError if the text cannot be read."""
    match = _DURATION.fullmatch(text.strip().lower())
    try:
        if match:
            return timedelta(seconds=float(match[1]) * UNITS_S[match[2]])
    except OverflowError:
        pass
    raise ConfigError(f"--older-than cannot be {text!r}; give a number and s, m, h, d or w, such as 30d or 12h")


def write_age(seconds: float) -> str:
    """Return an age as text, such as 45 min, 3 h or 12 d, in the largest unit that gives at least 2."""
    for unit, name in (("d", "d"), ("h", "h"), ("m", "min")):
        if seconds >= 2 * UNITS_S[unit]:
            return f"{seconds / UNITS_S[unit]:.0f} {name}"
    return f"{max(seconds, 0):.0f} s"


def measure_age_s(entry: Entry, now: datetime | None = None) -> float:
    """Return the seconds since an entry was built or last changed."""
    return ((now or datetime.now(UTC)) - entry.created).total_seconds()


@dataclass(frozen=True)
class Criteria:
    """The conditions for removing an entry. An entry is removed if it meets all conditions."""

    older_than: Annotated[
        str | None, declare("--older-than AGE", "Remove entries older than this: 30d, 12h, 2w, ...")
    ] = None
    stage: Annotated[list[str] | None, declare("--stage NAME", "Remove entries of this stage; may be repeated.")] = None
    incomplete: Annotated[
        bool,
        declare(
            "--incomplete", "Remove the remains of interrupted builds; these builds then start from the beginning."
        ),
    ] = False
    keep_newest: Annotated[
        int | None, declare("--keep-newest N", "Keep the newest N entries of each stage.", min=1)
    ] = None
    everything: Annotated[bool, declare("--all", "Remove all entries.")] = False

    def __post_init__(self) -> None:
        some = bool(self.stage or self.older_than is not None or self.incomplete or self.keep_newest)
        if not (self.everything or some):
            raise ConfigError("no condition is given; give --older-than, --stage, --incomplete, --keep-newest or --all")
        if self.everything and some:
            raise ConfigError("--all excludes other conditions; leave out --all, or leave out the others")

    def choose(self, entries: Sequence[Entry]) -> list[Entry]:
        """Return the entries to remove, in the given order. Raises ConfigError if a stage is not in the store."""
        known = {entry.stage for entry in entries}
        if unknown := [stage for stage in self.stage or () if stage not in known]:
            raise ConfigError(f"the store has no stage {unknown[0]!r}; {advise_choice(unknown[0], sorted(known))}")
        least_s = 0.0 if self.older_than is None else parse_age(self.older_than).total_seconds()
        kept, now = set(self._find_newest(entries)), datetime.now(UTC)
        return [
            entry
            for entry in entries
            if entry.path not in kept
            and (not self.stage or entry.stage in self.stage)
            and (self.older_than is None or measure_age_s(entry, now) > least_s)
            and not (self.incomplete and entry.complete)
        ]

    def _find_newest(self, entries: Sequence[Entry]) -> Iterator[Any]:
        """Yield the paths of the newest finished entries of each stage."""
        for group in group_by_stage(entries).values():
            finished = sorted((e for e in group if e.complete), key=lambda e: e.created, reverse=True)
            yield from (entry.path for entry in finished[: self.keep_newest or 0])


def group_by_stage(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """Return the entries grouped by stage."""
    groups: defaultdict[str, list[Entry]] = defaultdict(list)
    for entry in entries:
        groups[entry.stage].append(entry)
    return dict(groups)


class Origins:
    """The objects and components from which entries were made, according to the manifests of entries and inputs."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        found = {entry.digest: _read_inputs(entry) for entry in entries if entry.complete}
        self._inputs = {digest: inputs for digest, inputs in found.items() if inputs is not None}
        # slot and name of each component; the key is the component's class
        self._names = {c.spec.target: (c.spec.slot, c.spec.name) for c in registry().components}

    def is_readable(self, entry: Entry) -> bool:
        """Return whether the entry is finished and has a readable manifest. Checksums of files are not verified."""
        return entry.digest in self._inputs

    def find(self, entry: Entry) -> dict[str, str]:
        """Return the origins of an entry: "object" (the object's name or mesh digest), and components by slot."""
        parts = dict(self._list_parts(self._inputs.get(entry.digest, {}), frozenset({entry.digest})))
        return {key: parts[key] for key in ("object", *SLOTS) if key in parts}

    def _list_parts(self, value: Any, seen: frozenset[str]) -> Iterator[tuple[str, str]]:
        """Yield the parts that inputs name. If inputs refer to other stages, the parts of these stages come first."""
        if isinstance(value, str) and _DIGEST.fullmatch(value):
            if (digest := value[:16]) in self._inputs and digest not in seen:
                yield from self._list_parts(self._inputs[digest], seen | {digest})
        elif isinstance(value, Mapping):
            if "mesh" in value and "symmetry" in value:
                yield "object", f"mesh {str(value['mesh'])[:8]} ({value['symmetry']})"
            elif value.get("class") in self._names:
                yield self._names[value["class"]]
            for item in value.values():
                yield from self._list_parts(item, seen)
            if value.get(LABEL):
                yield "object", value[LABEL]


def _read_inputs(entry: Entry) -> Mapping[str, Any] | None:
    from tactile_loc.store.artifact import read_artifact

    try:
        key = read_artifact(entry.path).key
    except StoreError:
        return None
    return {**key.inputs, LABEL: key.label}
