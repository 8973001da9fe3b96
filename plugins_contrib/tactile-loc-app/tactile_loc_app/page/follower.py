"""Work that follows a moving hand: only the newest request counts."""

from collections.abc import Callable
from threading import Condition, Thread
from typing import Generic, TypeVar

Asked = TypeVar("Asked")


class Follower(Generic[Asked]):
    """Calls `work` with the newest request, in an own thread. Requests that arrive meanwhile replace each other."""

    def __init__(self, work: Callable[[Asked], None]) -> None:
        self.done = 0  # number of requests that were worked on
        self._work, self._stopped = work, False
        self._wanted: list[Asked] = []
        self._changed = Condition()
        self._thread = Thread(target=self._run, name="follower", daemon=True)
        self._thread.start()

    def ask(self, request: Asked) -> None:
        """Request work, instead of an earlier request that has not begun."""
        with self._changed:
            self._wanted = [request]
            self._changed.notify()

    def stop(self) -> None:
        """End the thread after its current work."""
        with self._changed:
            self._stopped = True
            self._changed.notify()
        self._thread.join(timeout=5)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted or self._stopped)
                if self._stopped:
                    return
                (request,), self._wanted = self._wanted, []
            self._work(request)
            self.done += 1
