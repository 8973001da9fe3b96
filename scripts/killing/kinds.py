"""The kinds of trials: commands killed, on full disks, with read-only stores, and several at once.

Each yields the number of trials that it has done since it was asked last.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from record import Done

from killing import remains
from killing.commands import COMMANDS, Moment, Place, end_group
from killing.trials import Plan, Trials, taken

KILL = -9
FINISHED = 0.2  # the share of runs after a kill that are let finish
PAGE, ROOMY = 4096, 2**30  # bytes of a disk
LARGEST = 400_000  # bytes of a file, where a limit of that stands for a full disk
UNWRITABLE = 0.5  # the share of stages that are not stored, where some are to be built
PROCESSES, KILLED = 8, 3  # at once, and how many of them are killed
BEGINS = re.compile(r"Stage (\S+ \S+) is being built\.")


def kill(plan: Plan) -> Iterator[int]:
    """Kill each command and begin it again, judge what it leaves, and now and then let it finish."""
    for name in plan.commands:
        trials, wanted = plan.trials("kill", name), plan.share("kill", name)
        yield min(wanted, trials.counts["killed"])
        if trials.counts["killed"] < wanted:
            yield from kill_one(trials, wanted, Place(plan.out / "kill" / name).make(plan.inputs))


def kill_one(trials: Trials, wanted: int, place: Place) -> Iterator[int]:
    """Kill a command so many times."""
    calm, line, counts = trials.plan.calm(trials.name), COMMANDS[trials.name], trials.counts
    before: set[str] = set()
    streak, stored = 0, True
    while counts["killed"] < wanted or streak:
        draw = trials.draw()
        let = counts["killed"] >= wanted or (streak > 0 and draw.random() < FINISHED)
        life = calm.cold if draw.random() < 0.7 else calm.warm
        done = place.whole(line) if let else place.killed(line, Moment.drawn(life, draw))
        before = trials.find_lost(before, place)
        beside = len(remains.leftovers(place)) - len(calm.leftovers)
        counts["most left beside"] = max(counts["most left beside"], beside)
        if done.code == KILL and not let:
            trials.find(*remains.broken(place, ended=False))
            trials.count("killed")
            streak += 1
            yield 1
        else:
            trials.judge(done, place, trials.name, stored)
            trials.count("let finish" if let else "faster")
            stored = _begin_anew(place, trials.plan.inputs, draw)
            before, streak = set(), 0


def _begin_anew(place: Place, inputs: Path, draw: np.random.Generator) -> bool:
    """Keep nothing, the old results alone, or the store alone. Return whether all is to be stored."""
    what = draw.integers(3)
    if what == 0:
        place.make(inputs)
    elif what == 1:
        shutil.rmtree(place.store, ignore_errors=True)
    else:
        place.renew_work(inputs)
    return bool(what != 1)


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


@contextmanager
def _too_little(folder: Path, trials: Trials) -> Iterator[tuple[Place, tuple[str, ...], Path | None]]:
    """Yield a place whose disk holds the inputs and a random share of the need, or a prefix that limits all files."""
    share, inputs = float(trials.draw().uniform(0.01, 1)), trials.plan.inputs
    if not can_mount():
        limit = f'ulimit -f {max(1, int(share**2 * LARGEST) // 1024)}; exec "$@"'
        yield Place(folder).make(inputs), ("bash", "-c", limit, "-"), None
        return
    with mounted(folder / "disk") as disk:
        place, nbytes = Place(disk, said=folder).make(inputs), trials.plan.calm(trials.name).nbytes
        remount(disk, f"size={-(-(taken(place) + int(share * nbytes)) // PAGE) * PAGE}")
        yield place, (), disk


def full(plan: Plan) -> Iterator[int]:
    """Run each command on a disk with too little room, then with enough."""
    for name in plan.commands:
        trials = plan.trials("full", name)
        yield trials.number
        while trials.number < plan.share("full", name):
            plan.calm(name)
            with _too_little(plan.out / "full" / name, trials) as (place, prefix, disk):
                done = place.whole(COMMANDS[name], prefix)
                trials.expect(_is_refused(name, done) or done.code == 0, "no sentence", done)
                trials.find(*remains.broken(place, ended=True))
                before = remains.finished(place)
                if disk is not None:
                    remount(disk, f"size={ROOMY}")
                trials.go_on(name, place, before)
            trials.count("refused" if done.code else "had room")
            yield 1


def _is_refused(name: str, done: Done) -> bool:
    """Whether a command ended with one sentence, or a sweep with the number of its failed rows."""
    in_rows = name == "sweep" and done.code == 1 and done.err.splitlines()[-1].startswith("failed: ")
    return done.is_refusal or in_rows


def read_only(plan: Plan) -> Iterator[int]:
    """Run commands with a store that can only be read: with all that they need, with half of it, and on the store."""
    trials, names, folder = plan.trials("read-only", "stores"), sorted(plan.commands), plan.out / "read-only"
    yield trials.number
    if not can_mount():
        trials.counts["left out: no disk may be mounted"] = 1
        return
    shutil.rmtree(folder, ignore_errors=True)
    while trials.number < plan.wanted["read-only"]:
        draw, (round_, which) = trials.draw(), divmod(trials.number, len(names))
        with mounted(folder / "disk") as disk:
            place = Place(folder, disk / "store").make(plan.inputs)
            place.whole(COMMANDS[names[which]])
            for path in sorted(place.store.glob("*/*")) if round_ == 1 else []:
                if path.is_dir() and draw.random() < UNWRITABLE:
                    shutil.rmtree(path)
            before = remains.finished(Place(disk))
            remount(disk, "ro")
            came = _on_the_store(place, trials) if round_ > 1 else _with_the_store(names[which], round_, place, trials)
            trials.expect(before == remains.finished(Place(disk)), "the store has changed")
            trials.count(came)
        yield 1


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
    for name in ("build", "run"):
        trials, folder, calm = plan.trials("at-once", name), plan.out / "at-once" / name, plan.calm(name)
        yield trials.number
        for kind in ("undisturbed", "some killed", "one folder"):
            while trials.counts[f"done, {kind}"] < plan.wanted["at-once"] // 6:
                draw, store, left = trials.draw(), folder / "store", range(PROCESSES)
                roots = [folder / f"{0 if kind == 'one folder' else k}" for k in range(PROCESSES)]
                places = [Place(root, store, folder / f"said-{k}").make(plan.inputs) for k, root in enumerate(roots)]
                processes = [place.begin(f"{COMMANDS[name]} -v") for place in places]
                if kind == "some killed":
                    order = [int(k) for k in draw.permutation(PROCESSES)]
                    left = order[KILLED:]
                    for k in order[:KILLED]:
                        with suppress(subprocess.TimeoutExpired):
                            processes[k].wait(timeout=float(draw.uniform(0, calm.cold.whole_s)))
                        end_group(processes[k])
                done = {k: places[k].ended(processes[k]) for k in left}
                for k, came in done.items():
                    trials.judge(came, places[k], name)
                if kind != "some killed":
                    begun = Counter(stage for one in done.values() for stage in BEGINS.findall(one.err))
                    trials.expect(bool(begun), "nobody built anything")
                    twice = [stage for stage, count in begun.items() if count > 1]
                    trials.expect(not twice, f"built more than once: {', '.join(twice)}")
                trials.count(f"done, {kind}")
                yield 1
