"""Tables are aligned. Progress bars show the notes of the running task and vanish when it ends."""

from tactile_loc_cli import console
from tactile_loc_cli.console import Bars, Lines, complain, name_flags, say_table, write_flags


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
    with name_flags(["--touch-unit", "-o", "--option"]):
        complain("error", text)
    assert capsys.readouterr().err == f"error: {text}\n".replace("`touch_unit`", "--touch-unit")
    assert write_flags(text) == text


def test_a_short_row_does_not_widen_a_column(capsys):
    say_table([["name", "x", "y"], ["a", "1", "22"], ["b", "cannot be located at all"]], left=1, gap=2)
    assert capsys.readouterr().out.splitlines() == ["name  x   y", "a     1  22", "b     cannot be located at all"]


def test_a_narrow_window_wraps_the_last_column(capsys, monkeypatch):
    rows = [["a", "about"], ["bc", "some words that do not fit"]]
    say_table(rows, gap=2, fold=True)
    assert capsys.readouterr().out.splitlines() == ["a   about", "bc  some words that do not fit"]
    monkeypatch.setattr(console, "UNKNOWN_WIDTH", 25)
    say_table(rows, gap=2, fold=True)
    assert capsys.readouterr().out.splitlines() == ["a   about", "bc  some words that do", "    not fit"]
