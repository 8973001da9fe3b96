"""The kinds of trials (killed commands, full disks, several commands at once), and the checks after each trial."""

import json
import os
import re
import shutil
import subprocess
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from record import Done, Record

from killing import remains
from killing.commands import COMMANDS, Life, Moment, Place, kill_group

KILL = -9
FINISHED = 0.2  # share of kills after which the command may finish
PAGE, ROOMY = 4096, 2**30  # bytes of a disk
PROCESSES, KILLED = 8, 3  # commands at once, and how many of them are killed
TOGETHER = [f"{name}, {how}" for name in ("build", "run") for how in ("undisturbed", "some killed", "one folder")]
BEGINS = re.compile(r"stage (\S+ \S+) is being built(?! by)")


@dataclass(frozen=True)
class Calm:
    """An undisturbed command: its first run with an empty store, its second run, and the files of both runs."""

    cold: Life
    warm: Life
    answer: dict[str, str]
    leftovers: list[str]
    locks: int
    nbytes: int  # bytes on the disk, without the inputs


@dataclass(frozen=True)
class Plan:
    """The trials to do, and their folder. `wanted` has the number of trials of each kind, for all commands together."""

    out: Path
    inputs: Path
    record: Record
    commands: Sequence[str]
    wanted: dict[str, int]

    def run_calm(self, name: str) -> Calm:
        """Run a command undisturbed, or read its earlier outcome. Raises RuntimeError if the command fails."""
        kept = self.out / "calm" / f"{name}.json"
        if kept.is_file():
            values = json.loads(kept.read_text(encoding="utf-8"))
            return Calm(**{**values, "cold": Life(**values["cold"]), "warm": Life(**values["warm"])})
        place = Place(self.out / "calm" / name).reset(self.inputs)
        before = place.count_bytes()
        (done, cold), (again, warm) = place.watch(COMMANDS[name]), place.watch(COMMANDS[name])
        if done.code or again.code or (wrong := remains.find_broken(place, ended=True)):
            raise RuntimeError(f"{COMMANDS[name]} does not work: {done.err or again.err or wrong}")
        answer, leftovers = remains.digest_answer(place), remains.list_leftovers(place)
        found = Calm(cold, warm, answer, leftovers, remains.count_locks(place), place.count_bytes() - before)
        kept.write_text(json.dumps(asdict(found), indent=1) + "\n", encoding="utf-8")
        return found


@dataclass(frozen=True)
class Trials:
    """The trials of one kind with one command: their number, outcomes and findings."""

    plan: Plan
    kind: str
    name: str

    @property
    def counts(self) -> Counter[str]:
        """The number of each outcome."""
        return self.plan.record.of(f"{self.kind} {self.name}")

    @property
    def number(self) -> int:
        """The number of the present trial, from 0."""
        return self.counts["trials"]

    @property
    def folder(self) -> Path:
        """The folder of the trials."""
        return self.plan.out / self.kind / re.sub(r"\W+", "-", self.name)

    def make_generator(self) -> np.random.Generator:
        """Return the random generator of the present trial."""
        name = zlib.crc32(f"{self.kind} {self.name}".encode())
        return np.random.default_rng([self.plan.record.seed, name, self.number])

    def count(self, outcome: str) -> None:
        """End the trial, and count its outcome."""
        self.counts.update(("trials", outcome))
        self.plan.record.save()

    def add_findings(self, *findings: str) -> None:
        """Note findings of the present trial."""
        trial = {"kind": self.kind, "name": self.name, "number": self.number}
        self.plan.record.findings += [{**trial, "what": one} for one in findings]

    def expect(self, holds: bool, finding: str, done: Done | None = None) -> bool:
        """Unless `holds`, note a finding with the output of a command. Return `holds`."""
        if not holds:
            self.add_findings(finding if done is None else f"{finding}: exit code {done.code}, {done.err[-1500:]!r}")
        return holds

    def find_lost(self, before: set[str], place: Place) -> set[str]:
        """Note lost work as findings: work that was finished before and is missing now. Return the finished work."""
        after = remains.list_finished(place)
        self.add_findings(*(f"lost: {one}" for one in remains.find_lost(before, after, place)))
        return after

    def check(self, done: Done, place: Place, name: str, stored: bool = True) -> None:
        """Check that a finished command gives the answer of an undisturbed run, and leaves no other files.

        `stored` is false if the store was deleted while old results were kept. Then stages may be missing.
        """
        if not self.expect(done.code == 0, "it does not continue", done):
            return
        self.add_findings(*remains.find_broken(place, ended=True))
        calm, answer = self.plan.run_calm(name), remains.digest_answer(place)
        asked = {
            key: one for key, one in calm.answer.items() if stored or key in answer or not key.startswith(remains.STAGE)
        }
        other = sorted(key for key in asked.keys() | answer if asked.get(key) != answer.get(key))
        self.expect(not other, f"another answer: {', '.join(other)}")
        left = [name for name in remains.list_leftovers(place) if name not in calm.leftovers]
        self.expect(not left, f"left behind: {', '.join(left)}")
        self.expect(remains.count_locks(place) <= calm.locks, "more locks than stages")


def _kill_once(trials: Trials) -> str:
    """Start and kill a command repeatedly, on the files that it left, until it finishes."""
    draw, place, line = trials.make_generator(), Place(trials.folder), COMMANDS[trials.name]
    calm, stored, before = trials.plan.run_calm(trials.name), _begin_anew(place, trials.plan.inputs, draw), set[str]()
    while True:
        life = calm.cold if draw.random() < 0.7 else calm.warm
        done = place.run_and_kill(line, Moment.draw(life, draw))
        before, outcome = trials.find_lost(before, place), "faster"
        beside = len(remains.list_leftovers(place)) - len(calm.leftovers)
        trials.counts["most left beside"] = max(trials.counts["most left beside"], beside)
        if done.code == KILL:
            trials.add_findings(*remains.find_broken(place, ended=False))
            trials.counts["killed"] += 1
            if draw.random() > FINISHED:
                continue
            done, outcome = place.run(line), "let finish"
            trials.find_lost(before, place)
        trials.check(done, place, trials.name, stored)
        return outcome


def _begin_anew(place: Place, inputs: Path, draw: np.random.Generator) -> bool:
    """Delete all files, only the store, or only the results. Return whether a run will store all its stages."""
    kept = draw.integers(3) if place.work.is_dir() else 0
    if kept == 0:
        place.reset(inputs)
    elif kept == 1:
        shutil.rmtree(place.store, ignore_errors=True)
    else:
        shutil.rmtree(place.work)
        shutil.copytree(inputs, place.work)
    shutil.rmtree(place.temporary)
    place.temporary.mkdir()
    return bool(kept != 1)


@cache
def can_mount() -> bool:
    """Return whether this process may mount disks."""
    words = ["unshare", "-m", "mount", "-t", "tmpfs", "none", "/mnt"]
    return os.geteuid() == 0 and subprocess.run(words, capture_output=True, check=False).returncode == 0


@contextmanager
def mount_disk(folder: Path) -> Iterator[Path]:
    """Mount a disk in memory at a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={ROOMY}", "none", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def _resize(disk: Path, nbytes: int) -> None:
    subprocess.run(["mount", "-o", f"remount,size={nbytes}", str(disk)], check=True)


def _starve(trials: Trials) -> str:
    """Run a command on a disk that holds the inputs and a random share of the space that it needs."""
    if not can_mount():
        return "left out: no disk may be mounted"
    line, share = COMMANDS[trials.name], float(trials.make_generator().uniform(0.01, 1))
    need = share * trials.plan.run_calm(trials.name).nbytes
    with mount_disk(trials.folder / "disk") as disk:
        place = Place(disk, output=trials.folder).reset(trials.plan.inputs)
        _resize(disk, -(-(place.count_bytes() + int(need)) // PAGE) * PAGE)
        done = place.run(line)
        # A sweep reports the number of its failed rows instead.
        in_rows = trials.name == "sweep" and done.code == 1 and done.err.splitlines()[-1].startswith("failed: ")
        trials.expect(done.is_refusal or in_rows or done.code == 0, "not refused in one sentence", done)
        trials.add_findings(*remains.find_broken(place, ended=True))
        before = remains.list_finished(place)
        _resize(disk, ROOMY)
        again = place.run(line)
        trials.find_lost(before, place)
        trials.check(again, place, trials.name)
    return "refused" if done.code else "had space"


def _run_together(trials: Trials) -> str:
    """Run a command several times at once on one store: undisturbed, with some runs killed, or all in one folder."""
    name, _, how = trials.name.partition(", ")
    draw, folder, left = trials.make_generator(), trials.folder, list(range(PROCESSES))
    roots = [folder / f"{0 if how == 'one folder' else k}" for k in left]
    places = [Place(roots[k], folder / "store", folder / f"said-{k}").reset(trials.plan.inputs) for k in left]
    processes = [place.start(f"{COMMANDS[name]} -v") for place in places]
    if how == "some killed":
        order = [int(k) for k in draw.permutation(PROCESSES)]
        left = order[KILLED:]
        for k in order[:KILLED]:
            with suppress(subprocess.TimeoutExpired):
                processes[k].wait(timeout=float(draw.uniform(0, trials.plan.run_calm(name).cold.whole_s)))
            kill_group(processes[k])
    done = {k: places[k].wait_for(processes[k]) for k in left}
    for k, one in done.items():
        trials.check(one, places[k], name)
    if how != "some killed":
        begun = Counter(stage for one in done.values() for stage in BEGINS.findall(one.err))
        trials.expect(bool(begun), "no stage was built")
        twice = [stage for stage, count in begun.items() if count > 1]
        trials.expect(not twice, f"built more than once: {', '.join(twice)}")
    return "done"


KINDS = {"kill": _kill_once, "full": _starve, "at-once": _run_together}


def run_trials(plan: Plan, kind: str) -> Iterator[int]:
    """Do the missing trials of a kind. Yield the number of trials (or kills) in each step."""
    names = TOGETHER if kind == "at-once" else plan.commands
    every, more = divmod(plan.wanted[kind], len(names))
    counted = "killed" if kind == "kill" else "trials"
    for k, name in enumerate(names):
        trials, before = Trials(plan, kind, name), 0
        while trials.counts[counted] < every + (k < more):
            yield trials.counts[counted] - before
            before = trials.counts[counted]
            trials.count(KINDS[kind](trials))
        yield trials.counts[counted] - before
