"""Notifications: errors and warnings in the words of the page, each to the visitor who caused it."""

import logging
import threading

import pytest
from tactile_loc.plugin import TouchError

from tactile_loc_app.page.notices import Notices, hide_folder, name_controls

library = logging.getLogger("tactile_loc.some.module")


class Client:
    """A visitor's browser that keeps its notifications."""

    def __init__(self) -> None:
        self.shown: list[tuple[str, str, str]] = []

    def add_notification(self, title: str, text: str, auto_close_seconds: float, color: str) -> None:
        self.shown.append((title, text, color))


@pytest.fixture
def client() -> Client:
    return Client()


def test_messages_use_the_words_of_the_page(tmp_path):
    text = f"{tmp_path}/touches/a.npy has no unit; give `touch_unit` or `other`"
    assert name_controls(hide_folder(text, tmp_path)) == 'a.npy has no unit; give "Unit of depths" or `other`'


def test_an_error_and_warnings_are_shown_and_a_program_error_without_a_traceback(client, tmp_path, caplog):
    def work() -> None:
        for _ in range(2):
            library.warning("the photo %s is dark", tmp_path / "a.png")
        raise TouchError("give `touch_unit`")

    Notices(client, tmp_path).attempt(work)
    shown = [(text, colour) for _, text, colour in client.shown]
    assert shown == [('give "Unit of depths"', "red"), ("the photo a.png is dark", "yellow")]
    Notices(client, tmp_path).attempt(lambda: [][0])
    assert client.shown[-1][1] == "IndexError: list index out of range"
    assert "Traceback" in caplog.text


def test_notes_on_an_object_are_shown_once_and_not_as_warnings(client, tmp_path):
    notices = Notices(client, tmp_path)
    note = "part.stl is read as 40 mm; give `units` m to confirm the unit"

    def work() -> None:
        library.warning(note)
        notices.tell_once((note,))

    for _ in range(2):
        notices.attempt(work)
    assert client.shown == [("Note", "part.stl is read as 40 mm.", "blue")]


def test_warnings_of_other_threads_are_not_shown(client, tmp_path):
    def work() -> None:
        other = threading.Thread(target=library.warning, args=("of somebody else",))
        other.start()
        other.join()

    Notices(client, tmp_path).attempt(work)
    assert client.shown == []
    assert logging.getLogger("tactile_loc").handlers == [
        handler for handler in logging.getLogger("tactile_loc").handlers if type(handler).__name__ != "_ThreadWarnings"
    ]


def test_values_that_the_program_sets_start_no_work(client, tmp_path):
    done = []
    act = Notices(client, tmp_path).guard(lambda: done.append(1))
    act(type("Event", (), {"client_id": None}))
    assert done == []
    act(type("Event", (), {"client_id": 3}))
    assert done == [1]
