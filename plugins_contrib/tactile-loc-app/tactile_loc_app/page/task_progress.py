"""The progress of a visitor's long work, shown on the page."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tactile_loc.plugin import Progress

from tactile_loc_app.errors import AppError

EVERY_S = 0.2  # least time between two updates of the page

ShowProgress = Callable[[str, float], None]


class TaskProgress(Progress):
    """Shows the running task and its share, 0 to 1. It ends the work when `is_wanted` returns False."""

    def __init__(self, show: ShowProgress | None = None, is_wanted: Callable[[], bool] = lambda: True) -> None:
        self.show, self._is_wanted = show, is_wanted
        self._task, self._done, self._total, self._shown_s = "", 0, 1, 0.0

    @contextmanager
    def task(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Open a task of `total` steps. The yielded function raises AppError if the work is unwanted."""
        self._task, self._done, self._total, self._shown_s = description, 0, max(total, 1), 0.0
        yield self._advance

    def _advance(self, steps: int) -> None:
        if not self._is_wanted():
            raise AppError("the calibration was stopped; calibrate again")
        self._done += steps
        now_s = time.monotonic()
        if self.show is not None and now_s - self._shown_s > EVERY_S:
            self._shown_s = now_s
            self.show(self._task, min(self._done / self._total, 1.0))
