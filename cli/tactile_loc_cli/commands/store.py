"""`tactile-loc store`: what the store of built stages holds."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tactile_loc.core.formatting import byte_size
from tactile_loc_cli.console import say, say_table
from tactile_loc_cli.options import Store

if TYPE_CHECKING:
    from tactile_loc.store.store import Entry, StageStore
    from tactile_loc_cli.stored import Origins


def list_store(store: Store = None) -> dict[str, Any]:
    """List what the store holds, the newest last.

    For each stage: its digest, size, age, whether it is complete, and what it was made from.
    """
    from tactile_loc_cli.stored import Origins, age_in_words

    place = _open(store)
    entries = sorted(place.entries(), key=lambda entry: entry.created)
    origins = Origins(entries)
    rows = [_row(place, entry, origins) for entry in entries]
    if rows:
        shown = [
            [r["stage"], r["digest"], byte_size(r["bytes"]), age_in_words(r["age_s"]), r["state"],
             ", ".join(r["made_from"].values())] for r in rows
        ]  # fmt: skip
        say_table([["stage", "digest", "size", "age", "state", "made from"], *shown], left=(0, 1, 4, 5))
    say(_in_all(place, entries))
    return {"store": str(place.root), "entries": rows, "bytes": _bytes(entries)}


def size(store: Store = None) -> dict[str, Any]:
    """Say how much room the store takes, by stage."""
    from tactile_loc_cli.stored import by_stage

    place = _open(store)
    entries = place.entries()
    stages = {
        stage: {"entries": len(group), "incomplete": sum(not entry.complete for entry in group), "bytes": _bytes(group)}
        for stage, group in by_stage(entries).items()
    }
    if stages:
        shown = [[stage, *map(str, (s["entries"], s["incomplete"])), byte_size(s["bytes"])]
                 for stage, s in stages.items()]  # fmt: skip
        say_table([["stage", "entries", "incomplete", "size"], *shown], left=1)
    say(_in_all(place, entries))
    return {"store": str(place.root), "stages": stages, "entries": len(entries), "bytes": _bytes(entries)}


def prune(
    older_than: Annotated[
        str | None, typer.Option("--older-than", metavar="AGE", help="What was built longer ago: 30d, 12h, 2w, ...")
    ] = None,
    stage: Annotated[
        list[str] | None, typer.Option("--stage", metavar="NAME", help="Of this stage only; may be repeated.")
    ] = None,
    incomplete: Annotated[
        bool, typer.Option("--incomplete", help="What interrupted builds left; they then start anew.")
    ] = False,
    keep_newest: Annotated[
        int | None, typer.Option("--keep-newest", min=1, metavar="N", help="All but the newest N of each stage.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Everything.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be removed.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
    store: Store = None,
) -> dict[str, Any]:
    """Remove what is not needed from the store.

    Several conditions: what meets them all. What is being built now is left alone. What is removed and needed later is
    built again.
    """
    from tactile_loc_cli.stored import Criteria, parse_age

    age = None if older_than is None else parse_age(older_than)
    criteria = Criteria(everything, tuple(stage or ()), age, incomplete, keep_newest or 0)
    place = _open(store)
    chosen = criteria.choose(place.entries())
    busy = [entry for entry in chosen if place.is_being_built(entry)]
    free = [entry for entry in chosen if entry not in busy]
    for entry in busy:
        say(f"left alone, it is being built now: {_called(entry)}")
    if free and not (dry_run or yes or _is_confirmed(free)):
        free = []
    removed, kept = (free, []) if dry_run else _remove(place, free)
    _say_removed(place, removed, dry_run)
    record = {"removed": _recorded(removed), "left_alone": _recorded([*busy, *kept])}
    return {"store": str(place.root), "dry_run": dry_run, **record, "bytes": _bytes(removed)}


COMMANDS: Mapping[str, Callable[..., dict[str, Any]]] = {"list": list_store, "size": size, "prune": prune}


def _open(store: Store) -> StageStore:
    from tactile_loc.store.store import StageStore

    return StageStore(store)


def _row(place: StageStore, entry: Entry, origins: Origins) -> dict[str, Any]:
    from tactile_loc_cli.stored import age_s

    if entry.complete:
        state = "complete" if origins.is_readable(entry) else "damaged"
    else:
        state = "being built" if _is_being_built(place, entry) else "interrupted"
    return {
        "stage": entry.stage, "digest": entry.digest, "bytes": entry.nbytes, "created": entry.created.isoformat(),
        "age_s": age_s(entry), "complete": entry.complete, "state": state, "made_from": origins.of(entry),
    }  # fmt: skip


def _is_being_built(place: StageStore, entry: Entry) -> bool:
    """As the store says; False where we may not ask, as in a store that can only be read."""
    from tactile_loc.core.errors import StoreError

    try:
        return place.is_being_built(entry)
    except StoreError:
        return False


def _is_confirmed(entries: Sequence[Entry]) -> bool:
    """Let the person decide. Raises ConfigError where there is none to ask."""
    from tactile_loc.core.errors import ConfigError

    if not _is_terminal():
        raise ConfigError("nobody is here to confirm that; give --yes, or --dry-run to see what would be removed")
    return typer.confirm(f"Remove {_counted(entries)}, {byte_size(_bytes(entries))}?", err=True)


def _is_terminal() -> bool:
    """Whether somebody can answer a question."""
    return sys.stdin.isatty()


def _remove(place: StageStore, entries: Sequence[Entry]) -> tuple[list[Entry], list[Entry]]:
    """Remove the entries; return those that are gone, and those that another process took meanwhile."""
    from tactile_loc.core.errors import StoreError

    gone, kept = [], []
    for entry in entries:
        try:
            place.remove(entry.digest)
        except StoreError:
            if not place.is_being_built(entry):
                raise
            kept.append(entry)
            say(f"left alone, it is being built now: {_called(entry)}")
        else:
            gone.append(entry)
    return gone, kept


def _say_removed(place: StageStore, entries: Sequence[Entry], dry_run: bool) -> None:
    for entry in entries:
        say(f"{'would remove' if dry_run else 'removed'} {_called(entry)}, {byte_size(entry.nbytes)}")
    verb = "would be removed" if dry_run else "removed"
    say(f"{_counted(entries)}, {byte_size(_bytes(entries))}, {verb} from {place.root}")


def _recorded(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    return [{"stage": entry.stage, "digest": entry.digest, "bytes": entry.nbytes} for entry in entries]


def _called(entry: Entry) -> str:
    return f"{entry.stage} {entry.digest}"


def _counted(entries: Sequence[Entry]) -> str:
    return f"{len(entries)} {'entry' if len(entries) == 1 else 'entries'}"


def _bytes(entries: Sequence[Entry]) -> int:
    return sum(entry.nbytes for entry in entries)


def _in_all(place: StageStore, entries: Sequence[Entry]) -> str:
    return f"{_counted(entries)}, {byte_size(_bytes(entries))} in {place.root}"
