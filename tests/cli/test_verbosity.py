"""The options -v, -vv and -q before and after the command, and the messages of unexpected errors."""

import logging
import re
import sys
from pathlib import Path

import pytest
from cli_helpers import TINY, succeed
from message_helpers import missing
from tactile_loc_cli.console import Bars, Lines, make_progress, show_log

from tactile_loc.core.runtime.progress import NOTE, Progress
from tactile_loc.plugins.refiners.none import NoRefiner
from tactile_loc.store.keys import MEANINGS

PIN = ["--object", "pin", *TINY]
INFO = re.compile(r"info: \[\d+\.\d s\] \S.*")


@pytest.fixture
def build(cli, tmp_path):
    """Build into a separate store, with words before and after the command; return the lines on stderr."""

    def run(before: list[str], after: list[str], store: str = "new") -> list[str]:
        done = succeed(cli(*before, "build", *PIN, "--store", tmp_path / store, *after))
        return done.stderr.splitlines()

    return run


@pytest.mark.parametrize(("before", "after"), [(["-v"], []), ([], ["-v"]), (["-v", "-q"], ["--verbose"])])
def test_verbose_reports_each_stage_with_its_time(build, before, after):
    lines = build(before, after)
    assert all(map(INFO.fullmatch, lines)), lines
    for stage in ("grid", "shapes", "bank", "temperature"):
        told = [
            line for line in lines if re.search(rf"\b{stage} [0-9a-f]{{16}} \({re.escape(MEANINGS[stage])}\)", line)
        ]
        assert len(told) >= 2, "one line before the stage and one after it"
        assert re.search(r"\d k?B\b.*\d s\b", told[-1])
    assert re.fullmatch(r"info: \[.*\] .*\bbuild\b.* \d+\.\d s\b.*", lines[-1])


def test_debug_lines_are_shown_only_with_vv(build):
    assert build([], []) == []
    for before, after in ((["-vv"], []), (["-v"], ["-v"]), ([], ["-vv"])):
        lines = build(before, after)
        assert [line for line in lines if line.startswith("debug: ")]
        assert any("already" in line for line in lines)
    assert not [line for line in build(["-v"], []) if line.startswith("debug: ")]


def test_only_a_calibration_named_like_a_sensor_is_warned_about_and_reached_by_its_path(cli):
    Path("digit").mkdir()
    assert cli("build", *PIN, "--sensor", "digit").stderr == ""
    Path("digit/calibration.json").write_text("{}")
    done = cli("build", *PIN, "--sensor", "./digit")
    assert done.exit_code == 2
    assert "digit" in done.stderr  # the folder is read as a calibration and refused
    assert "CalibrationError" in cli("build", *PIN, "--sensor", "./digit", "--json").stdout
    words = ["build", *PIN, "--sensor", "digit"]
    (warning,) = cli(*words).stderr.splitlines()
    assert warning.startswith("warning: ")
    assert "./digit" in warning
    for hushed in (["-q", *words], [*words, "-q"], [*words, "--quiet", "--json"]):
        assert cli(*hushed).stderr == "", "quiet hides warnings"
    done = cli("build", "--object", "pinn", "-q")
    assert (done.exit_code, done.stderr.startswith("error: ")) == (2, True), "quiet hides no error"


def test_a_repeated_warning_is_shown_once_and_notes_without_v_unless_quiet(capsys):
    logger = logging.getLogger("tactile_loc.core")
    with show_log():
        for text in ("a", "b", "a"):
            logger.warning(text)
    assert capsys.readouterr().err == "warning: a\nwarning: b\n"
    for verbosity, shown in ((0, "note: a\n"), (1, "note: a\n"), (-1, "")):
        with show_log(verbosity):
            logger.log(NOTE, "a")
        assert capsys.readouterr().err == shown


def test_logger_levels_are_restored(capsys):
    logger = logging.getLogger("tactile_loc")
    before = (logger.level, list(logger.handlers))
    with show_log(5):
        assert logger.level == logging.DEBUG
        with show_log(-5):
            assert logger.level == logging.ERROR
        assert logger.level == logging.DEBUG
    assert (logger.level, logger.handlers) == before


def test_quiet_shows_no_progress(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with show_log():
        assert isinstance(make_progress(), Bars)
    with show_log(-1):
        assert type(make_progress()) is Progress
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False)
    with show_log():
        assert isinstance(make_progress(), Lines)


@pytest.fixture
def broken(monkeypatch):
    """Let the refiner 'none' raise an unexpected error."""

    def let(error: Exception) -> list[str]:
        def fail(*_):
            raise error

        monkeypatch.setattr(NoRefiner, "refine", fail)
        return ["run", *PIN, "--refiner", "none"]

    return let


def test_an_unexpected_error_names_the_component_in_one_line(cli, broken):
    done = cli(*broken(ZeroDivisionError("by\n  nothing")))
    assert done.exit_code == 1
    assert re.fullmatch(r"error: .*\n", done.stderr)
    assert not missing(done.stderr, "ZeroDivisionError", "refiner 'none'", "by nothing", "-vv")


def test_vv_shows_the_traceback_of_any_error(cli, broken):
    done = cli("-vv", *broken(KeyError()))
    assert done.exit_code == 1
    assert "Traceback" in done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith("error: ")
    assert not missing(last, "KeyError", "refiner 'none'")
    assert missing(last, "-vv"), "the message advises -vv although it was given"
    expected = cli("run", *PIN, "--touch", "none.npz", "-vv")
    assert "Traceback" in expected.stderr
    assert expected.stderr.splitlines()[-1].startswith("error: ")
    assert expected.exit_code == 2


def test_an_error_outside_components_names_the_command(cli, monkeypatch):
    def fail(*_):
        raise RuntimeError

    monkeypatch.setattr("tactile_loc.locate.stored_object.load_stored_object", fail)
    done = cli("build")
    assert done.exit_code == 1
    assert re.fullmatch(r"error: .*\n", done.stderr)
    assert not missing(done.stderr, "RuntimeError", "build", "-vv")


def test_a_full_disk_is_an_expected_error(cli, broken):
    done = cli(*broken(OSError(28, "No space left on device", "cache.nbi")))
    assert done.exit_code == 2
    assert "cache.nbi" in done.stderr
    assert "space" in done.stderr
    assert "unexpected" not in done.stderr
