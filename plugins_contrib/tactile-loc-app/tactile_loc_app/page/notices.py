"""Reports to one visitor: errors and notes as notifications, in the words of the page."""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc import TactileLocError
from tactile_loc.commands import fold_line

if TYPE_CHECKING:
    from viser import ClientHandle

logger = logging.getLogger(__name__)

NOTE_S, FAULT_S = 7.0, 15.0  # seconds for which a note, and an error or a warning, stays
CONTROLS = {
    "touch_unit": '"Unit of depths"',
    "touch_kind": '"Depths are"',
    "ball_radius": '"Ball radius"',
    "mm_per_px": '"Size of a pixel"',
    "camera": '"Camera"',
    "sensor": '"Sensor"',
    "units": '"Unit of own files"',
    "zero": '"Upload the photo without contact"',
}
"""The page's control for each setting that messages of the library name."""


class Notices:
    """Notifications of one visitor, whose files lie in `folder`."""

    def __init__(self, client: ClientHandle, folder: Path) -> None:
        self.client, self.folder = client, folder
        self._told: set[str] = set()

    def guard(self, work: Callable[[], None]) -> Callable[[Any], None]:
        """Return a callback that does the work, unless the program set the value. It shows errors as notifications."""

        def act(event: Any) -> None:
            if getattr(event, "client_id", 0) is not None:
                self.attempt(work)

        return act

    def attempt(self, work: Callable[[], None]) -> None:
        """Do the work, and show its warnings and an error as notifications."""
        with catch_warnings() as warnings:
            try:
                work()
            except TactileLocError as error:
                self.show_error(error)
            except Exception as error:  # the page must go on; the log has the details
                logger.exception("the page failed")
                self.notify("The program failed", f"{type(error).__name__}: {error}", "red")
        for text in dict.fromkeys(warnings):
            if text not in self._told:
                self.notify("Warning", self._word(text), "yellow")

    def tell_once(self, notes: tuple[str, ...]) -> None:
        """Show the facts of notes about an object once a visit, although the library warns at each use of it."""
        for text in notes:
            if text not in self._told:
                self._told.add(text)
                self.notify("Note", f"{self._word(text.partition('; ')[0])}.")

    def show_error(self, error: TactileLocError) -> None:
        """Show an error as a notification."""
        self.notify("This did not work", self._word(str(error)), "red")

    def _word(self, text: str) -> str:
        return name_controls(hide_folder(text, self.folder))

    def notify(self, title: str, text: str, colour: Any = "blue") -> None:
        """Show a notification: in blue, a note that disappears soon."""
        seconds = NOTE_S if colour == "blue" else FAULT_S
        self.client.add_notification(fold_line(title), fold_line(text), auto_close_seconds=seconds, color=colour)


class _ThreadWarnings(logging.Handler):
    """Keeps the warnings that its own thread logs."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.thread, self.texts = threading.get_ident(), list[str]()

    def emit(self, record: logging.LogRecord) -> None:
        if record.thread == self.thread and record.levelno == logging.WARNING:
            self.texts.append(record.getMessage())


@contextmanager
def catch_warnings() -> Iterator[list[str]]:
    """Yield a list that receives the warnings that the library logs in this thread during the block."""
    handler, library = _ThreadWarnings(), logging.getLogger("tactile_loc")
    library.addHandler(handler)
    try:
        yield handler.texts
    finally:
        library.removeHandler(handler)


def name_controls(text: str) -> str:
    """Replace the settings that a message names, such as `touch_unit`, with the page's controls."""
    return re.sub(r"`(\w+)`", lambda found: CONTROLS.get(found[1], found[0]), text)


def hide_folder(text: str, folder: Path) -> str:
    """Replace the paths of files in a visitor's folder with their names."""
    return re.sub(re.escape(str(folder)) + r"/(?:[^/\s]+/)*", "", text)
