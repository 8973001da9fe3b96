"""Tables are aligned. Progress bars show the notes of the running task and vanish when it ends."""

from typing import Annotated

import pytest
import typer
from tactile_loc_cli import console
from tactile_loc_cli.command import build_command
from tactile_loc_cli.console import Bars, Lines, complain, name_flags, write_flags

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.slots.registry import CommandSpec


def test_a_note_is_shown_beside_the_running_bar(monkeypatch):
    import rich.progress

    shown = []
    update = rich.progress.Progress.update

    def note(self, *given, **named):
        shown.append(named.get("description"))
        update(self, *given, **named)

    monkeypatch.setattr(rich.progress.Progress, "update", note)
    bars = Bars()
    bars.note("before any task")
    with bars.task("training", 3) as advance:
        advance(1)
        bars.note("loss 1.25")
    bars.note("after it")
    assert shown == ["training: loss 1.25"]


def test_progress_without_a_terminal_is_a_line_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr(console, "EVERY_S", 10.0)
    now = iter([0.0, 0.0, 1.0, 10.0, 15.0, 20.0, 30.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(now))
    lines = Lines()
    lines.note("before any task")
    with lines.task("locating objects", 9) as advance:
        for steps in (1, 2, 1):
            advance(steps)
        lines.note("loss 1.25")
        advance(1)
        advance(4)
    said = ["3 of 9 in 10 s, about 20 s left", "5 of 9 in 20 s, about 16 s left (loss 1.25)"]
    assert capsys.readouterr().err.splitlines() == [f"note: locating objects: {words}" for words in said]


def test_names_of_settings_become_flags_of_the_command(capsys):
    text = "set `touch_unit`, or run `tactile-loc store prune`; `unknown` stays"
    with name_flags({"touch_unit": "--touch-unit", "option": "--option"}):
        complain("error", text)
    assert capsys.readouterr().err == f"error: {text}\n".replace("`touch_unit`", "--touch-unit")
    assert write_flags(text) == text


def test_an_argument_is_named_as_in_the_help(capsys):
    def press(out: Annotated[str, typer.Argument(metavar="FOLDER")]) -> None:
        raise OutputError(f"{out} is full; choose another `out`, or `sensor`")

    with pytest.raises(SystemExit):
        build_command(CommandSpec("press", "press", "here:press"), press).main(["here"], "press")
    assert capsys.readouterr().err == "error: here is full; choose another FOLDER, or `sensor`\n"
