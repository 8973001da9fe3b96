"""Cases that are done once each: files from another year, locks whose owners are dead, and waiting for the killed."""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

from killing import remains
from killing.commands import COMMANDS, Place, end_group
from killing.trials import Plan, Trials, repeat

YEAR_S = 365 * 86400
WAITS_S = 120
DEAD = "4194303\n"  # no process has such a number


def stored_in_another_year(years: int, trials: Trials, place: Place) -> None:
    """What is stored seems to be from another year, and is used all the same."""
    for name in ("evaluate", "train", "sweep", "replay"):
        place.make(trials.plan.inputs).whole(COMMANDS[name])
        when_s = time.time() + years * YEAR_S
        for path in (path for root in (place.work, place.store) for path in root.rglob("*")):
            os.utime(path, (when_s, when_s))
        trials.go_on(name, place, remains.finished(place))
        listed = place.whole("store list")
        trials.expect(listed.code == 0 and not listed.err, "store list", listed)


def locks_of_the_dead(trials: Trials, place: Place) -> None:
    """Lock files of dead processes, some from the future, disturb nothing."""
    for name in ("build", "train"):
        place.make(trials.plan.inputs).whole(COMMANDS[name])
        for folder in [path for path in place.store.glob("*/*") if path.is_dir()]:
            shutil.rmtree(folder)
        for lock in place.store.glob("*/*.lock"):
            lock.write_text(DEAD, encoding="utf-8")
            os.utime(lock, (time.time() + YEAR_S,) * 2)
            lock.chmod(0o444)
        trials.go_on(name, place)


def a_folder_for_a_lock(trials: Trials, place: Place) -> None:
    """A folder in the place of a lock is refused in one sentence."""
    place.make(trials.plan.inputs).whole(COMMANDS["build"])
    for lock in list(place.store.glob("*/*.lock")):
        lock.unlink()
        lock.mkdir()
        shutil.rmtree(lock.with_suffix(""))
    done = place.whole(COMMANDS["build"])
    trials.expect(done.is_refusal, "no sentence", done)


def waiting_for_one_that_is_killed(trials: Trials, place: Place) -> None:
    """A process waits for another one's training, which is killed, and continues with its checkpoint."""
    other = Place(place.root / "other", place.store).make(trials.plan.inputs)
    builder = place.make(trials.plan.inputs).begin(COMMANDS["train"])
    _wait(lambda: any(place.store.glob("encoder/*.partial/checkpoint.safetensors")) or builder.poll() is not None)
    os.killpg(builder.pid, signal.SIGSTOP)  # so that it does not end before the other has begun
    waiting = other.begin(f"{COMMANDS['train']} -v")
    _wait(lambda: "waiting for it" in other.outputs()[1].read_text() or waiting.poll() is not None)
    before = remains.finished(place)
    end_group(builder)
    done = other.ended(waiting)
    trials.expect("waiting for it" in done.err, "it did not wait", done)
    trials.find_lost(before, other)
    trials.expect("the saved piece checkpoint.safetensors is used" in done.err, "it began anew", done)
    trials.judge(done, other, "train")


def only_the_first_process_is_killed(trials: Trials, place: Place) -> None:
    """A sweep's own process is killed alone; the next sweep continues at once."""
    process = place.make(trials.plan.inputs).begin(COMMANDS["sweep"])
    _wait(lambda: any(place.work.glob("swept/rows/*.json")) or process.poll() is not None)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    trials.go_on("sweep", place)


CASES: dict[str, Callable[[Trials, Place], object]] = {
    "stored in the future": partial(stored_in_another_year, 10),
    "stored long ago": partial(stored_in_another_year, -30),
    "locks of the dead": locks_of_the_dead,
    "a folder for a lock": a_folder_for_a_lock,
    "waiting for one that is killed": waiting_for_one_that_is_killed,
    "only the first process is killed": only_the_first_process_is_killed,
}


def cases(plan: Plan) -> Iterator[int]:
    """Do each case once."""
    return repeat(plan, "cases", dict.fromkeys(list(CASES)[: plan.wanted["cases"]], 1), _do)


def _do(trials: Trials) -> str:
    shutil.rmtree(trials.folder, ignore_errors=True)
    CASES[trials.name](trials, Place(trials.folder))
    return "done"


def _wait(reached: Callable[[], bool]) -> None:
    end_s = time.monotonic() + WAITS_S
    while time.monotonic() < end_s:
        with suppress(FileNotFoundError):  # a file that goes away meanwhile
            if reached():
                return
        time.sleep(0.01)
