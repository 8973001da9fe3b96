"""Clocks that go back, and locks whose owners are dead."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from killing import remains
from killing.commands import Place, begin, command, ended, whole
from killing.kills import Undisturbed, judge_end
from killing.moments import Moment, end_group, killed
from killing.record import Trials
from tactile_loc.io.recordings import Recording, RecordingWriter, write_recording

YEAR_S = 365 * 86400
FAKETIME = shutil.which("faketime")
WAITS_S = 120
DEAD = "4194303\n"  # no process has such a number

Case = Callable[[Place, Trials, Mapping[str, Undisturbed], Path], object]


def stored_in_another_year(years: int) -> Case:
    """What is stored and written is said to be from another year: it is used all the same."""

    def case(place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path) -> None:
        for name in ("evaluate", "train", "sweep", "replay"):
            place.make(inputs)
            whole(place, command(name).words)
            when_s = time.time() + years * YEAR_S
            for root in (place.work, place.store):
                for path in root.rglob("*"):
                    os.utime(path, (when_s, when_s))
            before = remains.finished(place)
            judge_end(whole(place, command(name).words), place, calm[name], trials)
            trials.find(*(f"lost: {one}" for one in remains.lost(before, remains.finished(place), place)))
            listed = whole(place, ["store", "list"])
            trials.expect(listed.code == 0 and not listed.err, "store list", listed)

    return case


def goes_back_between(name: str) -> Case:
    """A command is killed, and goes on a year before."""

    def case(place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path) -> None:
        place.make(inputs)
        later = (str(FAKETIME), "-f", "+1y")
        process = begin(place, command(name).words, later, FAKETIME_DONT_FAKE_MONOTONIC="1")
        _wait(lambda: len(remains.finished(place)) > len(calm[name].answer) // 3 or process.poll() is not None)
        end_group(process)
        before = remains.finished(place)
        trials.find(*remains.broken(place, ended=False))
        judge_end(whole(place, command(name).words), place, calm[name], trials)
        trials.find(*(f"lost: {one}" for one in remains.lost(before, remains.finished(place), place)))

    return case


def recorded_with_jumps(place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path) -> None:
    """A recording's clock goes back and forth by days; killed and begun again, the replay says the same."""
    words = command("replay").words
    answers = []
    for kills in (0, 4):
        place.make(inputs)
        _with_jumps(place.work / "slide.mcap")
        for number in range(kills):
            killed(place, words, Moment(0.01 * number, calm["replay"].cold.changes * (number + 1) // (kills + 1)))
            trials.find(*remains.broken(place, ended=False))
        done = whole(place, words)
        trials.expect(done.code == 0, "it does not work", done)
        found = remains.answer(place)
        answers.append({name: one for name, one in found.items() if name.startswith("poses")})
        trials.expect(len(answers[-1]) == 3, "it does not write all")
    trials.expect(answers[0] == answers[1], "another answer")


def seen_in_another_year(place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path) -> None:
    """The files that are located as they come are from the future, and from before 1970."""
    for when_s in (time.time() + YEAR_S, -YEAR_S):
        place.make(inputs)
        for path in (place.work / "touches").iterdir():
            os.utime(path, (when_s, when_s))
        judge_end(whole(place, command("live").words), place, calm["live"], trials)


def locks_of_the_dead(place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path) -> None:
    """Files of locks are left, of processes that are dead, some from the future: nobody minds."""
    for name in ("build", "train"):
        place.make(inputs)
        whole(place, command(name).words)
        for folder in [path for path in place.store.glob("*/*") if path.is_dir()]:
            shutil.rmtree(folder)
        for lock in place.store.glob("*/*.lock"):
            lock.write_text(DEAD, encoding="utf-8")
            os.utime(lock, (time.time() + YEAR_S,) * 2)
            lock.chmod(0o444)
        judge_end(whole(place, command(name).words), place, calm[name], trials)


def a_folder_for_a_lock(place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path) -> None:
    """Something else stands where a lock should be: that is one sentence."""
    place.make(inputs)
    whole(place, command("build").words)
    for lock in list(place.store.glob("*/*.lock")):
        lock.unlink()
        lock.mkdir()
        shutil.rmtree(lock.with_suffix(""))
    done = whole(place, command("build").words)
    trials.expect(done.is_refusal, "no sentence", done)


def waiting_for_one_that_is_killed(place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path) -> None:
    """One process waits for another one's training; that is killed, and the waiting one goes on with it."""
    place.make(inputs)
    other = Place(place.root / "other", place.store)
    other.root.mkdir(exist_ok=True)
    words = command("train").words
    builder = begin(place, words)
    _wait(lambda: any(place.store.glob("encoder/*.partial/checkpoint.safetensors")) or builder.poll() is not None)
    os.killpg(builder.pid, signal.SIGSTOP)  # so that it does not end before the other has begun
    shutil.rmtree(other.work, ignore_errors=True)
    shutil.copytree(inputs, other.work)
    other.temporary.mkdir(exist_ok=True)
    waiting = begin(other, [*words, "-v"])
    _wait(lambda: "waiting for it" in other.outputs()[1].read_text() or waiting.poll() is not None)
    before = remains.finished(place)
    end_group(builder)
    done = ended(other, waiting)
    trials.expect("waiting for it" in done.err, "it did not wait", done)
    trials.find(*(f"lost: {one}" for one in remains.lost(before, remains.finished(other), other)))
    trials.expect("the piece checkpoint.safetensors is there already" in done.err, "it began anew", done)
    judge_end(done, other, calm["train"], trials)


def only_the_first_process_is_killed(
    place: Place, trials: Trials, calm: Mapping[str, Undisturbed], inputs: Path
) -> None:
    """A sweep's own process is killed alone; its workers hold no lock for long, and the next sweep goes on at once."""
    place.make(inputs)
    process = begin(place, command("sweep").words)
    _wait(lambda: any(place.work.glob("swept/rows/*.json")) or process.poll() is not None)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    judge_end(whole(place, command("sweep").words), place, calm["sweep"], trials)


CASES: dict[str, Case] = {
    "stored in the future": stored_in_another_year(10),
    "stored long ago": stored_in_another_year(-30),
    **{f"the clock goes back before {name} goes on": goes_back_between(name)
       for name in ("run", "train", "evaluate", "sweep", "replay")},
    "a recording's clock jumps": recorded_with_jumps,
    "files from other years come": seen_in_another_year,
    "locks of the dead": locks_of_the_dead,
    "a folder for a lock": a_folder_for_a_lock,
    "waiting for one that is killed": waiting_for_one_that_is_killed,
    "only the first process is killed": only_the_first_process_is_killed,
}  # fmt: skip


def disturb(name: str, trials: Trials, folder: Path, inputs: Path, calm: Mapping[str, Undisturbed]) -> None:
    """Do a case, once."""
    if trials.number:
        return
    place = Place(folder / name.replace(" ", "-"))
    shutil.rmtree(place.root, ignore_errors=True)
    place.root.mkdir(parents=True)
    if FAKETIME is None and name.startswith("the clock"):
        trials.count("left out: faketime is not installed")
        return
    CASES[name](place, trials, calm, inputs)
    trials.count("done")


def _wait(reached: Callable[[], bool]) -> None:
    end_s = time.monotonic() + WAITS_S
    while time.monotonic() < end_s:
        with suppress(FileNotFoundError):  # of what goes away while one looks
            if reached():
                return
        time.sleep(0.01)


def _with_jumps(path: Path) -> None:
    """Let the clock with which a recording was logged go back by a day after each third message."""
    messages = list(Recording(path).read_messages())

    def write(writer: RecordingWriter) -> None:
        for number, message in enumerate(messages):
            shift = -int(number // 3 % 2 * 86400e9)
            writer.copy(dataclasses.replace(message, log_time_ns=message.log_time_ns + shift))

    write_recording(path, write)
