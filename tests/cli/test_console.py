"""Progress and warnings on the terminal."""

from __future__ import annotations

import logging
import warnings

from tactile_loc_cli.console import Bars, complain, progress, warnings_shown

from tactile_loc.core.progress import Progress


def test_no_bars_where_nobody_watches(capsys):
    watcher = progress()
    assert type(watcher) is Progress
    with watcher.task("work", 3) as advance:
        advance(3)
    assert capsys.readouterr() == ("", "")


def test_bars_go_to_stderr_and_pass_errors_on(capsys):
    with Bars().task("work", 3) as advance:
        advance(1)
        advance(2)
    assert capsys.readouterr().out == ""


def test_an_error_is_one_line_whatever_it_says(capsys):
    complain("error", "first\n  second")
    assert capsys.readouterr().err == "error: first second\n"


def test_warnings_of_the_library_are_shown_and_those_of_others_are_not(capsys):
    with warnings_shown():
        logging.getLogger("tactile_loc.core.meshes").warning("guessed %s", "mm")
        logging.getLogger("tactile_loc.core.meshes").info("nobody asked")
        warnings.warn("for developers", stacklevel=1)
    assert capsys.readouterr().err == "warning: guessed mm\n"
    logging.getLogger("tactile_loc.core.meshes").warning("afterwards")
    assert "warning: afterwards" not in capsys.readouterr().err
