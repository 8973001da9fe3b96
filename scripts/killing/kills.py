"""Commands killed at random moments, begun again, and now and then let finish."""

from __future__ import annotations

import json
import shutil
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from killing import remains
from killing.commands import Command, Done, Place, whole
from killing.moments import Life, drawn, killed, lived
from killing.record import Trials

KILL = -9
FINISHED = 0.2  # of the runs after a kill are let finish


@dataclass(frozen=True)
class Undisturbed:
    """What a command comes to when nobody disturbs it: with nothing stored, and once more."""

    cold: Life
    warm: Life
    answer: dict[str, str]
    leftovers: list[str]
    locks: int
    nbytes: int
    """Of the disk, without the inputs."""


def undisturbed(command: Command, folder: Path, inputs: Path) -> Undisturbed:
    """Return what a command comes to, found out once and kept in `folder`. Raises RuntimeError when it fails."""
    kept = folder / f"{command.name}.json"
    if kept.is_file():
        values = json.loads(kept.read_text(encoding="utf-8"))
        lives = {name: Life(**values.pop(name)) for name in ("cold", "warm")}
        return Undisturbed(**lives, **values)
    place = Place(folder / command.name)
    place.root.mkdir(parents=True, exist_ok=True)
    place.make(inputs)
    before = taken(place)
    done, cold = lived(place, command.words)
    again, warm = lived(place, command.words)
    for one in (done, again):
        if one.code or (wrong := remains.broken(place, ended=True)):
            raise RuntimeError(f"{command.line} does not work: {one.err or wrong}")
    found = Undisturbed(cold, warm, remains.answer(place), remains.leftovers(place), remains.locks(place),
                        taken(place) - before)  # fmt: skip
    kept.write_text(json.dumps(asdict(found), indent=1) + "\n", encoding="utf-8")
    return found


def taken(place: Place) -> int:
    """Return how many bytes of the disk a place takes."""
    return sum(512 * path.lstat().st_blocks for path in place.root.rglob("*") if path.is_file())


def draw_of(trials: Trials) -> np.random.Generator:
    """Return what is drawn by chance in the present trial."""
    name = f"{trials.kind} {trials.name}"
    return np.random.default_rng([trials.record.seed, zlib.crc32(name.encode()), trials.number])


def kill(command: Command, wanted: int, trials: Trials, place: Place, inputs: Path, calm: Undisturbed,
         advance: Callable[[int], object]) -> None:  # fmt: skip
    """Kill a command `wanted` times, beginning it again each time, and judge what it leaves; the last run finishes."""
    place.root.mkdir(parents=True, exist_ok=True)
    place.make(inputs)
    before: set[str] = set()
    streak, stored = 0, True
    while trials.counts["killed"] < wanted or streak:
        draw = draw_of(trials)
        enough = trials.counts["killed"] >= wanted
        let = enough or (streak > 0 and draw.random() < FINISHED)
        life = calm.cold if draw.random() < 0.7 else calm.warm
        done = whole(place, command.words) if let else killed(place, command.words, drawn(life, draw))
        after = remains.finished(place)
        trials.find(*(f"lost: {one}" for one in remains.lost(before, after, place)))
        trials.most("most left beside", len(remains.leftovers(place)) - len(calm.leftovers))
        if done.code == KILL and not let:
            trials.find(*remains.broken(place, ended=False))
            trials.count("killed")
            before, streak = after, streak + 1
            advance(1)
        else:
            judge_end(done, place, calm, trials, stored)
            trials.count("let finish" if let else "faster")
            stored = _prepare(place, inputs, draw)
            before, streak = set(), 0


def judge_end(done: Done, place: Place, calm: Undisturbed, trials: Trials, stored: bool = True) -> None:
    """Judge a command that was let finish: as the undisturbed one, with nothing beside it.

    Unless all had to be `stored`: results that were there already need no stage.
    """
    if not trials.expect(done.code == 0, "it does not go on", done):
        return
    trials.find(*remains.broken(place, ended=True))
    answer = remains.answer(place)
    asked = {
        key: one for key, one in calm.answer.items() if stored or key in answer or not remains.is_stage(key)
    }  # fmt: skip
    other = sorted(key for key in asked.keys() | answer if asked.get(key) != answer.get(key))
    trials.expect(not other, f"another answer: {', '.join(other)}")
    left = [name for name in remains.leftovers(place) if name not in calm.leftovers]
    trials.expect(not left, f"left behind: {', '.join(left)}")
    trials.expect(remains.locks(place) <= calm.locks, "more locks than stages")


def _prepare(place: Place, inputs: Path, draw: np.random.Generator) -> bool:
    """Begin anew: with nothing, the old results alone, or the store alone; return whether all is to be stored."""
    what = draw.integers(3)
    if what == 0:
        place.make(inputs)
    elif what == 1:
        shutil.rmtree(place.store, ignore_errors=True)
    else:
        shutil.rmtree(place.work)
        shutil.copytree(inputs, place.work)
    return bool(what != 1)
