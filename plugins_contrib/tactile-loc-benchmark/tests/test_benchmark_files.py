"""The files of a benchmark, and leaderboard files."""

import json

import numpy as np
import pytest
from pyarrow.parquet import read_table
from tactile_loc.plugin import ConfigError

from tactile_loc_benchmark.files import HEAD, read_benchmark, read_rows, tabulate, write_benchmark, write_rows
from tactile_loc_benchmark.leaderboard import read_standings
from tactile_loc_benchmark.prepare import hash_protocol
from tactile_loc_benchmark.suite import create


@pytest.fixture(scope="module")
def written(finished, tmp_path_factory):
    out = tmp_path_factory.mktemp("files")
    write_benchmark(out, finished.results)
    return out


def test_the_table_has_a_row_for_each_group(finished):
    groups = finished.results.groups
    header, *rows = tabulate(groups)
    assert header == list(HEAD)
    assert len(rows) == len(groups)
    first = dict(zip(header, rows[0], strict=False))
    assert (first["source"], first["touches"], first["method"]) == ("sketch", "1", "oracle")
    assert first["1 mm (95 % interval)"] == "100 % (100 to 100)"
    assert [row[1] for row in rows if row[0] == "sketch"] == ["1", "1", "2", "2"]


def test_the_markdown_has_a_row_for_what_was_left_out_and_the_parquet_file_all_rows(written, finished):
    text = (written / "benchmark.md").read_text()
    for label, problem in finished.results.left_out.items():
        (line,) = [line for line in text.splitlines() if line.startswith(f"| {label} |")]
        assert problem in line
    assert "public domain" in text
    assert "Anyone, anywhere" in text
    rows = read_rows(written / "rows.parquet")
    assert len(rows) == len(finished.results.rows)
    assert rows[0]["mssd_mm"] == finished.results.rows[0]["mssd_mm"]


def test_rows_are_written_with_a_type_for_each_column(tmp_path):
    rows = [
        {"n": 1, "x": np.float64(0.5), "t": "a", "mixed": 3, "yes": True},
        {"n": 2, "t": "b", "mixed": "c", "y": 4, "x": 7},
    ]
    first, second = read_table(write_rows(tmp_path / "rows.parquet", rows)).to_pylist()
    assert first == {"n": 1, "x": 0.5, "t": "a", "mixed": "3", "yes": True, "y": None}
    assert second == {"n": 2, "t": "b", "mixed": "c", "y": 4, "x": 7.0, "yes": None}


def test_the_failures_are_recorded(run_small, tmp_path):
    found = run_small(tmp_path, method=["oracle", {"name": "guess", "fault": "error"}])
    write_benchmark(tmp_path, found.results)
    (failed,) = json.loads((tmp_path / "benchmark.json").read_text())["failed"]
    assert (failed["method"], failed["error"]) == ("guess", "ValueError: nothing works")
    assert "ValueError: nothing works" in (tmp_path / "benchmark.md").read_text()


def test_a_leaderboard_file_is_read_back_and_names_no_path(written, finished, box_file):
    text = (written / "leaderboard.json").read_text()
    assert str(box_file.parent) not in text
    standings = list(read_standings(written / "leaderboard.json"))
    for standing, group in zip(standings, json.loads(json.dumps(finished.results.groups)), strict=True):
        assert group.items() <= standing.items()
    assert standings[0]["suite"] == "small"
    assert standings[0]["libraries"]["bench-fakes"] == "1.5"
    assert standings[-1]["component"] == "guess"


def test_only_the_protocol_the_source_and_the_objects_change_the_hash(finished, make_suite):
    prepared, known = finished.sources[0], finished.sources[0].used.protocol
    source = create("touch-source", prepared.entry)
    elsewhere = prepared.entry.model_copy(update={"options": {"data": "/somewhere/else"}})
    assert hash_protocol(make_suite(method=["guess"]), elsewhere, source, prepared.objects) == known
    assert hash_protocol(make_suite(seed=8), prepared.entry, source, prepared.objects) != known
    assert finished.sources[1].used.protocol != known


def test_results_of_another_version_are_refused(written, tmp_path):
    for name in ("leaderboard.json", "benchmark.json"):
        document = json.loads((written / name).read_text())
        (tmp_path / name).write_text(json.dumps({**document, "schema_version": 1}))
    (tmp_path / "rows.parquet").write_bytes((written / "rows.parquet").read_bytes())
    with pytest.raises(ConfigError, match=r"benchmark\.json has another version than 2; run the benchmark again"):
        read_benchmark(tmp_path)
    with pytest.raises(ConfigError, match=r"leaderboard\.json has another version"):
        list(read_standings(tmp_path / "leaderboard.json"))


@pytest.mark.parametrize("change", [{"groups": [{}]}, {"sources": {}}])
def test_a_damaged_leaderboard_file_gives_an_error(written, tmp_path, change):
    document = json.loads((written / "leaderboard.json").read_text())
    path = tmp_path / "leaderboard.json"
    path.write_text(json.dumps({**document, **change}))
    with pytest.raises(ConfigError, match=r"leaderboard\.json"):
        list(read_standings(path))
