"""Benchmark tables are saved and compared between versions; times are compared relative to a yardstick."""

import dataclasses
import re
import shlex
import subprocess

import bench
import pytest

PRINTED = """symmetry found
| object | faces | median, ms | error, mm |
|---|---|---|---|
| pin | 1768 | 50 | 0.10 |
| | 1768 | 60, 70 | 12 of 15 |
| hook | 6576 | 80 | left out |

| contact | share |
|---|---|
| 0 to 1 % | 59% |
"""


def kept(version, yardstick_ms=10.0, text=PRINTED):
    return bench.Kept("joint", ["pin"], version, "2026-01-01", 3.0, yardstick_ms, {"processor": "x", "cores": 2}, {},
                      bench.find_tables(text))  # fmt: skip


def test_tables_are_found_in_printed_text():
    first, second = bench.find_tables(PRINTED)
    assert first.columns == ["object", "faces", "median, ms", "error, mm"]
    assert first.rows[1] == ["", "1768", "60, 70", "12 of 15"]
    assert first.filled[1] == ["pin", "1768", "60, 70", "12 of 15"]
    assert first.numbers("median, ms", "pin") == [50]
    assert first.column("error, mm") == [0.1, 12]
    assert second.rows == [["0 to 1 %", "59%"]]


def test_each_figure_is_compared_with_its_earlier_value():
    found = bench.find_changes(kept("1"), kept("2", text=PRINTED.replace("0.10", "0.30")))
    changes = {change.where: change for change in found}
    assert changes["joint: pin, error, mm"].ratio == pytest.approx(3)
    assert [round(c.ratio, 6) for c in bench.find_changes(kept("1"), kept("2"))] == [1.0] * 13
    without_yardstick = {change.where for change in bench.find_changes(kept("1", None), kept("2"))}
    assert "joint: pin, error, mm" in without_yardstick
    assert not any("median, ms" in where for where in without_yardstick)


@pytest.mark.parametrize(
    ("yardstick_ms", "printed_ms", "fails"), [(10, "56", 1), (10, "54", 0), (20, "100", 0), (5, "50", 1)]
)
def test_a_time_that_grows_by_a_tenth_fails(tmp_path, capsys, yardstick_ms, printed_ms, fails):
    kept("0.9.0").write(tmp_path)
    kept("0.10.0", yardstick_ms, PRINTED.replace("| 50 |", f"| {printed_ms} |")).write(tmp_path)
    others = [c for c in bench.find_changes(kept("1"), kept("2", yardstick_ms)) if c.is_worse]
    assert bench.compare(tmp_path) == (1 if fails or others else 0)
    said = capsys.readouterr().out
    assert ("WORSE  joint: pin, median, ms:" in said) == bool(fails)
    assert "joint: 13 figures, 0.9.0 of 2026-01-01 -> 0.10.0 of 2026-01-01" in said
    assert said.count(" times)") == 13  # every figure, changed or not


@pytest.mark.parametrize(
    ("column", "before", "after", "yardstick_ms", "fails"),
    [
        ("error, mm", "0.10", "0.20", 10, 0),
        ("poses/s", "50.0", "45.0", 10, 1),
        ("poses/s", "50.0", "46.0", 10, 0),
        ("poses/s", "50.0", "20.0", 25, 0),
        ("x pyrender", "10.0", "9.0", 99, 1),
        ("x pyrender", "10.0", "9.5", 99, 0),
        ("x pyrender", "10.0", "20", 99, 0),
    ],
)
def test_only_a_speed_or_a_ratio_that_falls_by_a_tenth_fails(tmp_path, column, before, after, yardstick_ms, fails):
    text = f"| renderer | {column} |\n|---|---|\n| heightmap | {before} |\n"
    kept("0.1.0", text=text).write(tmp_path)
    kept("0.2.0", yardstick_ms, text.replace(before, after)).write(tmp_path)
    assert bench.compare(tmp_path) == fails


def test_a_single_version_is_compared_with_its_previous_committed_measurement(tmp_path, capsys):
    def commit():
        words = ["-c", "user.name=x", "-c", "user.email=x", "commit", "-qam", "x"]
        for command in (["add", "."], words):
            subprocess.run(["git", *command], cwd=tmp_path, check=True)

    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    path = kept("0.1.0").write(tmp_path)
    assert bench.compare(tmp_path) == 0
    assert "joint: measured once, 0.1.0" in capsys.readouterr().out
    commit()
    path.write_text('{"benchmark": "joint", "format": "of an older time"}')
    commit()
    measured = dataclasses.replace(kept("0.1.0", text=PRINTED.replace("| 50 |", "| 25 |")), date="2026-02-02")
    measured.write(tmp_path)
    commit()
    dataclasses.replace(measured, beside=["a sentence that was added later"]).write(tmp_path)
    assert bench.compare(tmp_path) == 0
    said = capsys.readouterr().out
    assert "0.1.0 of 2026-01-01 -> 0.1.0 of 2026-02-02" in said
    assert "joint: pin, median, ms: 5 -> 2.5 (0.50 times)" in said


def test_a_benchmark_is_run_and_its_results_are_saved(tmp_path, monkeypatch, capsys):
    script = tmp_path / "tiny.py"
    script.write_text(f"import sys\nprint({PRINTED!r})\nsys.exit(len(sys.argv) > 2)\n")
    monkeypatch.setattr(bench, "BENCHMARKS", tmp_path)
    result = bench.keep("tiny", [str(script)], tmp_path / "results")
    assert result.tables == bench.find_tables(PRINTED)
    assert result.arguments == ["tiny.py"]  # no path of this machine
    assert result.yardstick_ms > 0
    assert bench.Kept.read(next((tmp_path / "results").glob("*/tiny.json"))) == result
    monkeypatch.setattr(bench, "measure_yardstick_ms", lambda: 10.0)
    again = bench.keep("tiny", [], tmp_path / "results", run="tiny-again")
    assert (again.name, again.arguments) == ("tiny-again", [])
    assert bench.keep("tiny", [], tmp_path / "results").arguments == ["tiny.py"]  # as before
    unknown = dataclasses.replace(again, arguments=["FILE[:UNITS]", "..."])
    unknown.write(tmp_path / "results")
    with pytest.raises(SystemExit, match="with your own files; name them: FILE"):
        bench.keep("tiny", [], tmp_path / "results", run="tiny-again")
    with pytest.raises(SystemExit, match="nothing is kept"):
        bench.keep("tiny", ["a", "b"], tmp_path / "others")
    assert not (tmp_path / "others").exists()
    script.write_text("print('no table')")
    with pytest.raises(SystemExit, match="printed no table"):
        bench.keep("tiny", [], tmp_path / "others")
    with pytest.raises(SystemExit, match="there are tiny"):
        bench.keep("other", [])


def test_the_page_matches_the_saved_results():
    assert bench.PAGE.read_text() == bench.format_page()


def test_a_shell_reads_the_arguments_of_the_stated_command_again():
    arguments = ["a.obj:m", "--asked", "(gear|cam)", "--readings", "two words"]
    command = bench.format_command(dataclasses.replace(kept("0.1.0"), arguments=arguments))
    assert shlex.split(command)[-len(arguments) :] == arguments


def test_saved_results_contain_no_paths():
    for path in bench.RESULTS.glob("[0-9]*/*.json"):
        found = dataclasses.asdict(bench.Kept.read(path))
        assert not re.search(r"(/\w+){2}", str(found["arguments"]) + str(found["machine"]))
