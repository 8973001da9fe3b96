"""Rows on disk."""

from __future__ import annotations

import json

from tactile_loc.sweeps.combinations import combine
from tactile_loc.sweeps.kept import KeptRows
from tactile_loc.sweeps.plan import Plan
from tactile_loc.sweeps.work import Outcome


def test_a_row_is_kept_and_found(tmp_path):
    (one,), _ = combine(Plan.from_values({"object": "pin", "noise": "mild"}))
    kept = KeptRows(tmp_path / "out")
    assert kept.read(one.key) is None
    outcome = Outcome(one.key, {"total_ms": 0.1}, ("grid 1", "bank 2"))
    kept.keep(one, outcome)
    assert kept.read(one.key) == outcome
    record = json.loads((tmp_path / "out" / "rows" / f"{one.key}.json").read_text())
    assert record["configuration"]["touch"]["noise"] == "mild"
    assert record["configuration"]["grid"]["options"]["spacing_mm"] == 3.0
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["rows"]


def test_a_traceback_lies_beside_and_goes_when_it_succeeds(tmp_path):
    (one,), _ = combine(Plan.from_values({"object": "pin"}))
    kept = KeptRows(tmp_path)
    kept.keep(one, Outcome(one.key, None, (), "ValueError: no", "Traceback ...\nValueError: no"))
    trace = tmp_path / "errors" / f"{one.key}.txt"
    assert trace.read_text().endswith("ValueError: no")
    assert kept.read(one.key) == Outcome(one.key, None, (), "ValueError: no")
    kept.keep(one, Outcome(one.key, {}))
    assert not trace.exists()


def test_a_row_that_cannot_be_read_counts_as_none(tmp_path):
    kept = KeptRows(tmp_path)
    (tmp_path / "rows").mkdir()
    for text in ("", "{", "[]", '{"key": "k"}'):
        (tmp_path / "rows" / "k.json").write_text(text)
        assert kept.read("k") is None
