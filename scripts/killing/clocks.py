"""Clocks that go back, and locks whose owners are dead."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

from killing import remains
from killing.commands import COMMANDS, Moment, Place, end_group
from killing.trials import Plan, Trials
from tactile_loc.io.streams.recordings import Recording, RecordingWriter, write_recording

YEAR_S = 365 * 86400
FAKETIME = shutil.which("faketime")
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


def goes_back_between(name: str, trials: Trials, place: Place) -> None:
    """A command is killed, and begun again a year before."""
    place.make(trials.plan.inputs)
    enough = len(trials.plan.calm(name).answer) // 3
    process = place.begin(COMMANDS[name], (str(FAKETIME), "-f", "+1y"), FAKETIME_DONT_FAKE_MONOTONIC="1")
    _wait(lambda: len(remains.finished(place)) > enough or process.poll() is not None)
    end_group(process)
    trials.find(*remains.broken(place, ended=False))
    trials.go_on(name, place, remains.finished(place))


def recorded_with_jumps(trials: Trials, place: Place) -> None:
    """A recording's clock goes back and forth by days; a replay that was killed gives the same poses."""
    answers, changes = [], trials.plan.calm("replay").cold.changes
    for kills in (0, 4):
        place.make(trials.plan.inputs)
        _with_jumps(place.work / "slide.mcap")
        for number in range(kills):
            place.killed(COMMANDS["replay"], Moment(0.01 * number, changes * (number + 1) // (kills + 1)))
            trials.find(*remains.broken(place, ended=False))
        done = place.whole(COMMANDS["replay"])
        trials.expect(done.code == 0, "it does not work", done)
        answers.append({name: one for name, one in remains.answer(place).items() if name.startswith("poses")})
        trials.expect(len(answers[-1]) == 3, "it does not write all")
    trials.expect(answers[0] == answers[1], "another answer")


def seen_in_another_year(trials: Trials, place: Place) -> None:
    """The files that are located as they come are from the future, and from before 1970."""
    for when_s in (time.time() + YEAR_S, -YEAR_S):
        place.make(trials.plan.inputs)
        for path in (place.work / "touches").iterdir():
            os.utime(path, (when_s, when_s))
        trials.go_on("live", place)


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
    **{f"the clock goes back before {name} goes on": partial(goes_back_between, name)
       for name in ("run", "train", "evaluate", "sweep", "replay")},
    "a recording's clock jumps": recorded_with_jumps,
    "files from other years come": seen_in_another_year,
    "locks of the dead": locks_of_the_dead,
    "a folder for a lock": a_folder_for_a_lock,
    "waiting for one that is killed": waiting_for_one_that_is_killed,
    "only the first process is killed": only_the_first_process_is_killed,
}  # fmt: skip


def clock(plan: Plan) -> Iterator[int]:
    """Do each case once."""
    for name in list(CASES)[: plan.wanted["clock"]]:
        trials = Trials(plan, "clock", name)
        if not trials.number and FAKETIME is None and name.startswith("the clock"):
            trials.count("left out: faketime is not installed")
        elif not trials.number:
            folder = plan.out / "clock" / name.replace(" ", "-")
            shutil.rmtree(folder, ignore_errors=True)
            CASES[name](trials, Place(folder))
            trials.count("done")
        yield 1


def _wait(reached: Callable[[], bool]) -> None:
    end_s = time.monotonic() + WAITS_S
    while time.monotonic() < end_s:
        with suppress(FileNotFoundError):  # a file that goes away meanwhile
            if reached():
                return
        time.sleep(0.01)


def _with_jumps(path: Path) -> None:
    """Turn a recording's log clock back by a day after each third message."""
    messages = list(Recording(path).read_messages())

    def write(writer: RecordingWriter) -> None:
        for number, message in enumerate(messages):
            shift = -int(number // 3 % 2 * 86400e9)
            writer.copy(dataclasses.replace(message, log_time_ns=message.log_time_ns + shift))

    write_recording(path, write)
