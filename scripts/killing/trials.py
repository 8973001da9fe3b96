"""Kinds of trials: commands killed, on full disks, with read-only stores, and several at once; and their judgement."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from record import Done, Record

from killing import remains
from killing.commands import COMMANDS, Life, Moment, Place, end_group

KILL = -9
FINISHED = 0.2  # the share of runs after a kill that are let finish
PAGE, ROOMY = 4096, 2**30  # bytes of a disk
UNMOUNTABLE = "left out: no disk may be mounted"
UNWRITABLE = 0.5  # the share of stages that are not stored, where some are to be built
PROCESSES, KILLED = 8, 3  # at once, and how many of them are killed
BEGINS = re.compile(r"stage (\S+ \S+) is being built(?! by)")


@dataclass(frozen=True)
class Calm:
    """What a command comes to when nothing disturbs it: with nothing stored, and once more."""

    cold: Life
    warm: Life
    answer: dict[str, str]
    leftovers: list[str]
    locks: int
    nbytes: int  # of the disk, without the inputs


def taken(place: Place) -> int:
    """Return how many bytes of the disk a place takes."""
    return sum(512 * path.lstat().st_blocks for path in place.root.rglob("*") if path.is_file())


@dataclass(frozen=True)
class Plan:
    """What is to be done and where: the numbers of trials by kind, of all commands together."""

    out: Path
    inputs: Path
    record: Record
    commands: Sequence[str]
    wanted: dict[str, int]

    def shares(self, kind: str) -> dict[str, int]:
        """Return how many of a kind's trials are of each command."""
        every, more = divmod(self.wanted[kind], len(self.commands))
        return {name: every + (k < more) for k, name in enumerate(self.commands)}

    def calm(self, name: str) -> Calm:
        """Return what a command comes to, found once and kept. Raises RuntimeError when it fails."""
        kept = self.out / "calm" / f"{name}.json"
        if kept.is_file():
            values = json.loads(kept.read_text(encoding="utf-8"))
            return Calm(**{**values, "cold": Life(**values["cold"]), "warm": Life(**values["warm"])})
        place = Place(self.out / "calm" / name).make(self.inputs)
        before = taken(place)
        (done, cold), (again, warm) = place.lived(COMMANDS[name]), place.lived(COMMANDS[name])
        if done.code or again.code or (wrong := remains.broken(place, ended=True)):
            raise RuntimeError(f"{COMMANDS[name]} does not work: {done.err or again.err or wrong}")
        nbytes = taken(place) - before
        found = Calm(cold, warm, remains.answer(place), remains.leftovers(place), remains.locks(place), nbytes)
        kept.write_text(json.dumps(asdict(found), indent=1) + "\n", encoding="utf-8")
        return found


@dataclass(frozen=True)
class Trials:
    """The trials of one kind with one thing: how many were done, what became of them, and what was found."""

    plan: Plan
    kind: str
    name: str

    @property
    def counts(self) -> Counter[str]:
        """What became of the trials."""
        return self.plan.record.of(f"{self.kind} {self.name}")

    @property
    def number(self) -> int:
        """The number of the present trial: how many were done before."""
        return self.counts["trials"]

    @property
    def folder(self) -> Path:
        """Where the trials are done."""
        return self.plan.out / self.kind / re.sub(r"\W+", "-", self.name)

    def draw(self) -> np.random.Generator:
        """Return the randomness of the present trial."""
        return np.random.default_rng(
            [self.plan.record.seed, zlib.crc32(f"{self.kind} {self.name}".encode()), self.number]
        )

    def count(self, what: str) -> None:
        """End the trial: count it, and what became of it."""
        self.counts.update(("trials", what))
        self.plan.record.save()

    def find(self, *what: str) -> None:
        """Note findings of the present trial."""
        told = {"kind": self.kind, "name": self.name, "number": self.number}
        self.plan.record.findings += [{**told, "what": one} for one in what]

    def expect(self, holds: bool, what: str, done: Done | None = None) -> bool:
        """Note a finding unless something holds, with the output of a command. Return whether it holds."""
        if not holds:
            self.find(what if done is None else f"{what}: exit code {done.code}, {done.err[-1500:]!r}")
        return holds

    def find_lost(self, before: set[str], place: Place) -> set[str]:
        """Note what was finished before and is lost. Return what is finished now."""
        after = remains.finished(place)
        self.find(*(f"lost: {one}" for one in remains.lost(before, after, place)))
        return after

    def go_on(self, name: str, place: Place, before: set[str] | None = None) -> None:
        """Run a command to its end, and judge it; nothing of what was finished before may be lost."""
        done = place.whole(COMMANDS[name])
        self.find_lost(before or set(), place)
        self.judge(done, place, name)

    def judge(self, done: Done, place: Place, name: str, stored: bool = True) -> None:
        """Judge a command that was let finish: same answer as undisturbed, and nothing beside it.

        Stages of the answer may be missing unless all had to be `stored`: results that were there need no stage.
        """
        if not self.expect(done.code == 0, "it does not go on", done):
            return
        self.find(*remains.broken(place, ended=True))
        calm, answer = self.plan.calm(name), remains.answer(place)
        asked = {
            key: one for key, one in calm.answer.items() if stored or key in answer or not key.startswith(remains.STAGE)
        }
        other = sorted(key for key in asked.keys() | answer if asked.get(key) != answer.get(key))
        self.expect(not other, f"another answer: {', '.join(other)}")
        left = [name for name in remains.leftovers(place) if name not in calm.leftovers]
        self.expect(not left, f"left behind: {', '.join(left)}")
        self.expect(remains.locks(place) <= calm.locks, "more locks than stages")


def repeat(
    plan: Plan, kind: str, shares: Mapping[str, int], once: Callable[[Trials], str], counted: str = "trials"
) -> Iterator[int]:
    """Do so many trials of each name. Yield how many of what is `counted` were done since it was asked last.

    A trial is done by `once`, which returns what became of it.
    """
    for name, wanted in shares.items():
        trials, before = Trials(plan, kind, name), 0
        while trials.counts[counted] < wanted:
            yield trials.counts[counted] - before
            before = trials.counts[counted]
            trials.count(once(trials))
        yield trials.counts[counted] - before


def kill(plan: Plan) -> Iterator[int]:
    """Kill each command and begin it again, judge what it leaves, and now and then let it finish."""
    return repeat(plan, "kill", plan.shares("kill"), _kill, "killed")


def _kill(trials: Trials) -> str:
    """Kill a command once or several times, with what it has left each time, until it is let finish or is faster."""
    draw, place, line = trials.draw(), Place(trials.folder), COMMANDS[trials.name]
    calm, stored, before = trials.plan.calm(trials.name), _begin_anew(place, trials.plan.inputs, draw), set[str]()
    while True:
        life = calm.cold if draw.random() < 0.7 else calm.warm
        done = place.killed(line, Moment.drawn(life, draw))
        before, came = trials.find_lost(before, place), "faster"
        beside = len(remains.leftovers(place)) - len(calm.leftovers)
        trials.counts["most left beside"] = max(trials.counts["most left beside"], beside)
        if done.code == KILL:
            trials.find(*remains.broken(place, ended=False))
            trials.counts["killed"] += 1
            if draw.random() > FINISHED:
                continue
            done, came = place.whole(line), "let finish"
            trials.find_lost(before, place)
        trials.judge(done, place, trials.name, stored)
        return came


def _begin_anew(place: Place, inputs: Path, draw: np.random.Generator) -> bool:
    """Keep nothing, the old results alone, or the store alone. Return whether all is to be stored."""
    what = draw.integers(3) if place.work.is_dir() else 0
    if what == 0:
        place.make(inputs)
    elif what == 1:
        shutil.rmtree(place.store, ignore_errors=True)
    else:
        place.renew_work(inputs)
    shutil.rmtree(place.temporary)
    place.temporary.mkdir()
    return bool(what != 1)


@cache
def can_mount() -> bool:
    """Whether this process may mount disks."""
    words = ["unshare", "-m", "mount", "-t", "tmpfs", "none", "/mnt"]
    return os.geteuid() == 0 and subprocess.run(words, capture_output=True, check=False).returncode == 0


@contextmanager
def mounted(folder: Path) -> Iterator[Path]:
    """Mount a disk in memory at a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={ROOMY}", "none", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def remount(disk: Path, option: str) -> None:
    """Change an option of a mounted disk, as "ro" or "size=1000000"."""
    subprocess.run(["mount", "-o", f"remount,{option}", str(disk)], check=True)


def full(plan: Plan) -> Iterator[int]:
    """Run each command on a disk with too little room, then with enough."""
    return repeat(plan, "full", plan.shares("full"), _starve)


def _starve(trials: Trials) -> str:
    """Run a command on a disk that holds the inputs and a random share of what it needs."""
    if not can_mount():
        return UNMOUNTABLE
    line, share, folder = COMMANDS[trials.name], float(trials.draw().uniform(0.01, 1)), trials.folder
    need = share * trials.plan.calm(trials.name).nbytes
    with mounted(folder / "disk") as disk:
        place = Place(disk, said=folder).make(trials.plan.inputs)
        remount(disk, f"size={-(-(taken(place) + int(need)) // PAGE) * PAGE}")
        done = place.whole(line)
        trials.expect(_is_refused(trials.name, done) or done.code == 0, "no sentence", done)
        trials.find(*remains.broken(place, ended=True))
        before = remains.finished(place)
        remount(disk, f"size={ROOMY}")
        trials.go_on(trials.name, place, before)
    return "refused" if done.code else "had room"


def _is_refused(name: str, done: Done) -> bool:
    """Whether a command ended with one sentence, or a sweep with the number of its failed rows."""
    in_rows = name == "sweep" and done.code == 1 and done.err.splitlines()[-1].startswith("failed: ")
    return done.is_refusal or in_rows


def read_only(plan: Plan) -> Iterator[int]:
    """Run commands with a store that can only be read: with all that they need, with half of it, and on the store."""
    return repeat(plan, "read-only", {"stores": plan.wanted["read-only"]}, _lock_store)


def _lock_store(trials: Trials) -> str:
    if not can_mount():
        return UNMOUNTABLE
    names = sorted(trials.plan.commands)
    draw, (round_, which) = trials.draw(), divmod(trials.number, len(names))
    shutil.rmtree(trials.folder, ignore_errors=True)
    with mounted(trials.folder / "disk") as disk:
        place = Place(trials.folder, disk / "store").make(trials.plan.inputs)
        place.whole(COMMANDS[names[which]])
        for path in sorted(place.store.glob("*/*")) if round_ == 1 else []:
            if path.is_dir() and draw.random() < UNWRITABLE:
                shutil.rmtree(path)
        before = remains.finished(Place(disk))
        remount(disk, "ro")
        came = _on_the_store(place, trials) if round_ > 1 else _with_the_store(names[which], round_, place, trials)
        trials.expect(before == remains.finished(Place(disk)), "the store has changed")
    return came


def _with_the_store(name: str, round_: int, place: Place, trials: Trials) -> str:
    place.renew_work(trials.plan.inputs)
    done = place.whole(COMMANDS[name])
    if round_ == 0 and done.code == 0:
        trials.judge(done, place, name)
        return "works"
    refused = done.is_refusal if round_ == 0 else _is_refused(name, done)
    trials.expect(refused or done.code == 0, "no sentence", done)
    trials.find(*(remains.broken(place, ended=True) if round_ else ()))
    return "works" if done.code == 0 else "refused"


def _on_the_store(place: Place, trials: Trials) -> str:
    for line in ("store list", "store size"):
        done = place.whole(line)
        trials.expect(done.code == 0 and not done.err, f"{line} fails", done)
    done = place.whole("store prune --all --yes")
    trials.expect(done.is_refusal, "no sentence of store prune", done)
    return "works"


def at_once(plan: Plan) -> Iterator[int]:
    """Run a command several times at once: undisturbed, with some of them killed, and all into one folder."""
    names = [f"{name}, {how}" for name in ("build", "run") for how in ("undisturbed", "some killed", "one folder")]
    return repeat(plan, "at-once", dict.fromkeys(names, plan.wanted["at-once"] // len(names)), _begin_together)


def _begin_together(trials: Trials) -> str:
    name, _, how = trials.name.partition(", ")
    draw, folder, left = trials.draw(), trials.folder, list(range(PROCESSES))
    roots = [folder / f"{0 if how == 'one folder' else k}" for k in left]
    places = [Place(roots[k], folder / "store", folder / f"said-{k}").make(trials.plan.inputs) for k in left]
    processes = [place.begin(f"{COMMANDS[name]} -v") for place in places]
    if how == "some killed":
        order = [int(k) for k in draw.permutation(PROCESSES)]
        left = order[KILLED:]
        for k in order[:KILLED]:
            with suppress(subprocess.TimeoutExpired):
                processes[k].wait(timeout=float(draw.uniform(0, trials.plan.calm(name).cold.whole_s)))
            end_group(processes[k])
    done = {k: places[k].ended(processes[k]) for k in left}
    for k, came in done.items():
        trials.judge(came, places[k], name)
    if how != "some killed":
        begun = Counter(stage for one in done.values() for stage in BEGINS.findall(one.err))
        trials.expect(bool(begun), "nobody built anything")
        twice = [stage for stage, count in begun.items() if count > 1]
        trials.expect(not twice, f"built more than once: {', '.join(twice)}")
    return "done"
