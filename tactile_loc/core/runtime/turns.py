"""Long work in turns: it runs until its turn is used up, and goes on in its next turn.

A control loop can so spread a search over many frames. The work has a thread of its own, but only one of both threads
runs at any time. So the results do not depend on the speed of the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Semaphore, Thread
from typing import Any, Generic, TypeVar, cast

Result = TypeVar("Result")


def pause_before(share: float) -> None:
    """End the turn unless there is room in it for the work that follows, which takes this `share` of a turn.

    Shares are counted, not measured, so the turns do not depend on the speed of the machine. As a guide, a turn takes
    10 ms on an idle thread. If the calling work is not done in turns, nothing happens.

    Work that holds a lock must not pause, because the other thread may need this lock: see `without_pauses`. Until
    Python 3.11, a `cached_property` holds a lock while it is computed.
    """
    worker = _working.get()
    if worker is not None:
        worker.pause_before(share)


def split_into_turns(count: int, a_turn: float) -> Iterator[slice]:
    """Yield slices of range(count), with a pause before each if necessary. A turn has time for `a_turn` items.

    Work that is not done in turns gets a single slice.
    """
    at_once = max(1, int(a_turn / 2)) if takes_turns() else max(1, count)
    for first in range(0, max(1, count), at_once):
        last = min(count, first + at_once)
        pause_before((last - first) / a_turn)
        yield slice(first, last)


def takes_turns() -> bool:
    """Return whether the calling work is done in turns."""
    return _working.get() is not None


@contextmanager
def without_pauses() -> Iterator[None]:
    """Let `pause_before` do nothing until the block ends."""
    token = _working.set(None)
    try:
        yield
    finally:
        _working.reset(token)


class Turns(Generic[Result]):
    """Does `work()` in turns. Work that is no longer referenced is given up at its pause."""

    def __init__(self, work: Callable[[], Result]) -> None:
        self._worker: _Worker[Result] = _Worker(work)

    def take(self) -> bool:
        """Do the work up to its next pause, and return whether it is done. Raises what the work raises."""
        return self._worker.take()

    @property
    def result(self) -> Result:
        """The result of work that is done."""
        return cast(Result, self._worker.result)

    def __del__(self) -> None:
        self._worker.give_up()


class _GivenUpError(BaseException):
    """Ends work that is given up. No handler of errors catches it."""


class _Worker(Generic[Result]):
    """The state that both threads share. The working thread does not reference the `Turns`."""

    def __init__(self, work: Callable[[], Result]) -> None:
        self._work = work
        self._started = self._done = self._given_up = False
        self._used = 0.0  # share of the present turn
        self._go, self._back = Semaphore(0), Semaphore(0)
        self.result: Result | None = None
        self._error: BaseException | None = None

    def take(self) -> bool:
        if self._done:
            return True
        if self._started:
            self._go.release()
        else:
            self._started = True
            Thread(target=self._run, name="tactile-loc-turns", daemon=True).start()
        self._back.acquire()
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        return self._done

    def pause_before(self, share: float) -> None:
        if self._used and self._used + share > 1:
            self._used = 0.0
            self._back.release()
            self._go.acquire()
            if self._given_up:
                raise _GivenUpError
        self._used += share

    def give_up(self) -> None:
        if self._started and not self._done:
            self._given_up = True
            self._go.release()

    def _run(self) -> None:
        _working.set(self)
        try:
            self.result = self._work()
        except _GivenUpError:
            pass
        except BaseException as error:  # noqa: BLE001 - it is raised in the thread that takes the turn
            self._error = error
        finally:
            self._done = True
            self._back.release()


_working: ContextVar[_Worker[Any] | None] = ContextVar("working", default=None)
