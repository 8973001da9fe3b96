"""Commands on disks that are full, or can only be read."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from killing import remains
from killing.commands import Command, Done, Place, command, whole
from killing.disks import can_mount, limited, mounted
from killing.kills import Undisturbed, draw_of, judge_end, taken
from killing.record import Trials

LARGEST = 400_000  # bytes of a file, where a limit of that stands for a full disk
UNWRITABLE = 0.5  # of the stages are not stored, where some are to be built


def starve(one: Command, wanted: int, trials: Trials, folder: Path, inputs: Path, calm: Undisturbed) -> Iterator[None]:
    """Run a command on a disk with too little room, then with enough; yield after each time that was done."""
    while trials.number < wanted:
        draw = draw_of(trials)
        with _too_little(folder, inputs, calm, draw) as starved:
            done = whole(starved.place, one.words, starved.prefix)
            refused = done.is_refusal or _is_of_rows(one, done)
            trials.expect(refused or done.code == 0, "no sentence", done)
            trials.find(*remains.broken(starved.place, ended=True))
            before = remains.finished(starved.place)
            if starved.disk is not None:
                starved.disk.grow()
            again = whole(starved.place, one.words)
            lost = remains.lost(before, remains.finished(starved.place), starved.place)
            trials.find(*(f"lost: {word}" for word in lost))
            judge_end(again, starved.place, calm, trials)
        trials.count("refused" if done.code else "had room")
        yield


def _is_of_rows(one: Command, done: Done) -> bool:
    """Whether a sweep said how many of its rows failed; what each ended with stands in them."""
    return one.name == "sweep" and done.code == 1 and done.err.splitlines()[-1].startswith("failed: ")


@dataclass(frozen=True)
class Starved:
    """A place with too little room, and how a command is to be run there."""

    place: Place
    prefix: tuple[str, ...] = ()
    disk: object = None


@contextmanager
def _too_little(folder: Path, inputs: Path, calm: Undisturbed, draw: np.random.Generator) -> Iterator[Starved]:
    """A place on a disk that holds the inputs, and of what a command needs a share that is drawn by chance."""
    share = float(draw.uniform(0.01, 1))
    folder.mkdir(parents=True, exist_ok=True)
    if not can_mount():
        place = Place(folder)
        yield Starved(place.make(inputs), limited(int(share**2 * LARGEST)))
        return
    with mounted(folder / "disk") as disk:
        place = Place(disk.folder, said=folder).make(inputs)
        disk.set(f"size={taken(place) + int(share * calm.nbytes)}")
        yield Starved(place, disk=disk)


def read_only(wanted: int, trials: Trials, folder: Path, inputs: Path, calm: dict[str, Undisturbed]) -> Iterator[None]:
    """Run commands with a store that can only be read: what needs what is stored works, or all say one sentence."""
    names = sorted(calm)
    shutil.rmtree(folder, ignore_errors=True)
    while trials.number < wanted:
        draw = draw_of(trials)
        one = command(names[trials.number % len(names)])
        round_ = trials.number // len(names)
        with mounted(folder / "disk") as disk:
            place = Place(folder, disk.folder / "store").make(inputs)
            whole(place, one.words)
            if round_ == 1:
                _forget(place, draw)
            before = remains.finished(Place(folder / "disk", disk.folder / "store"))
            disk.set("ro")
            if round_ == 0:
                _only_what_is_stored(one, place, trials, inputs, calm[one.name])
            elif round_ == 1:
                _what_is_to_be_built(one, place, trials, inputs)
            else:
                _commands_of_the_store(place, trials)
            after = remains.finished(Place(folder / "disk", disk.folder / "store"))
            trials.expect(before == after, "the store has changed")
        yield


def _forget(place: Place, draw: np.random.Generator) -> None:
    """Remove some of what is stored."""
    for path in sorted(place.store.glob("*/*")):
        if path.is_dir() and draw.random() < UNWRITABLE:
            shutil.rmtree(path)


def _again(place: Place, inputs: Path) -> None:
    """Begin again with the store alone."""
    shutil.rmtree(place.work)
    shutil.copytree(inputs, place.work)


def _only_what_is_stored(one: Command, place: Place, trials: Trials, inputs: Path, calm: Undisturbed) -> None:
    _again(place, inputs)
    done = whole(place, one.words)
    if done.code == 0:
        judge_end(done, place, calm, trials)
    else:
        trials.expect(done.is_refusal, "no sentence", done)
    trials.count("works" if done.code == 0 else "refused")


def _what_is_to_be_built(one: Command, place: Place, trials: Trials, inputs: Path) -> None:
    _again(place, inputs)
    done = whole(place, one.words)
    refused = done.is_refusal or _is_of_rows(one, done)
    trials.expect(refused or done.code == 0, "no sentence", done)
    trials.find(*remains.broken(place, ended=True))
    trials.count("refused" if refused else "works")


def _commands_of_the_store(place: Place, trials: Trials) -> None:
    """What is asked of the store itself is answered, or refused in one sentence."""
    for words in (["store", "list"], ["store", "size"]):
        done = whole(place, words)
        trials.expect(done.code == 0 and not done.err, f"{words} fails", done)
    done = whole(place, ["store", "prune", "--all", "--yes"])
    trials.expect(done.is_refusal, "no sentence of store prune", done)
    trials.count("works")
