"""A short run of the kill trials, and tests of their checks."""

import json

import pytest
from killing import remains
from killing.commands import FLAT, Place
from killing.trials import Plan, Trials, run_trials
from record import Done, Record

from tactile_loc import StageKey, StageStore

KEY = StageKey("bank", 1, {"mesh": "a"})


@pytest.fixture
def place(tmp_path) -> Place:
    """A place with a finished artifact, an interrupted build and finished lines."""
    (tmp_path / "inputs").mkdir()
    here = Place(tmp_path / "place").reset(tmp_path / "inputs")
    StageStore(here.store).build(KEY, lambda work: work.save_json("numbers", [1, 2]))
    with pytest.raises(KeyboardInterrupt):
        StageStore(here.store).build(StageKey("grid", 1, {}), interrupted)
    (here.work / "found.jsonl").write_text('{"name": "a", "seconds": 1}\n{"name": "b"}\n')
    return here


def interrupted(work) -> None:
    work.save_json("first", 1)
    raise KeyboardInterrupt


@pytest.mark.slow
def test_a_killed_build_is_restarted(tmp_path):
    (tmp_path / "inputs").mkdir()
    (tmp_path / "inputs" / "flat.toml").write_text(FLAT)
    plan = Plan(tmp_path, tmp_path / "inputs", Record(tmp_path / "record.json", 0), ["build"], {"kill": 1})
    killed = sum(run_trials(plan, "kill"))
    assert killed == Trials(plan, "kill", "build").counts["killed"] >= 1
    assert plan.record.findings == []
    assert len(plan.run_calm("build").answer) > 10
    assert list(run_trials(plan, "kill")) == [killed], "no trial is left"


@pytest.mark.parametrize(
    ("path", "content", "found"),
    [
        ("work/result.json", b'{"a": ', "work/result.json: JSONDecodeError"),
        ("work/found.jsonl", b'{"a": 1}\n{"a"', "ends in half a line"),
        ("work/table.csv", b"a,b\n1,", "ends in half a line"),
        ("work/picture.png", b"\x89PNG\r\n\x1a\n", "work/picture.png"),
        ("work/touch.npz", b"PK", "work/touch.npz"),
        (f"store/bank/{KEY.short}/numbers.json", b"[1, 3]", "artifact bank"),
    ],
)
def test_only_broken_files_are_reported(place, path, content, found):
    assert remains.find_broken(place, ended=True) == []
    (place.root / path).write_bytes(content)
    (said,) = remains.find_broken(place, ended=True)
    assert found in said


def test_finished_items_that_vanish_unused_are_lost(place):
    before = remains.list_finished(place)
    assert {word.split()[0] for word in before} == {"artifact", "piece", "line"}
    StageStore(place.store).build(StageKey("grid", 1, {}), lambda work: work.save_json("whole", 2))
    assert remains.find_lost(before, remains.list_finished(place), place) == []
    StageStore(place.store).remove(KEY.digest)
    StageStore(place.store).build(KEY, lambda work: work.save_json("numbers", [1, 2]))
    (place.work / "found.jsonl").write_text('{"name": "b"}\n')
    lost = remains.find_lost(before, remains.list_finished(place), place)
    assert [word.split()[0] for word in lost] == ["artifact", "line", "line"]


def test_parts_that_wait_for_their_library_are_lost_unless_it_is_written(place):
    waiting = place.work / "library" / ".records"
    waiting.mkdir(parents=True)
    (waiting / "workers.log").touch()
    (waiting / "ab12").write_bytes(b"record")
    before = remains.list_finished(place)
    (waiting / "ab12").unlink()
    (lost,) = remains.find_lost(before, remains.list_finished(place), place)
    assert lost.startswith("part ab12")
    (waiting.parent / "library.json").write_text("{}")
    assert remains.find_lost(before, remains.list_finished(place), place) == []


def test_the_answer_digest_ignores_times(place):
    before = remains.digest_answer(place)
    for text, same in (('{"name": "a", "seconds": 2}\n{"name": "b"}\n', True), ('{"name": "b"}\n', False)):
        (place.work / "found.jsonl").write_text(text)
        assert (remains.digest_answer(place) == before) == same


def test_trials_are_recorded_in_a_file(tmp_path):
    path = tmp_path / "record.json"

    def plan(seed: int) -> Plan:
        return Plan(tmp_path, tmp_path, Record.open(path, seed), ["build"], {"kill": 1})

    trials = Trials(plan(3), "kill", "build")
    assert not trials.expect(False, "wrong", Done(1, "", "error"))
    trials.count("killed")
    again = plan(3)
    assert Trials(again, "kill", "build").number == 1
    told = {"kind": "kill", "name": "build", "number": 0, "what": "wrong: exit code 1, 'error'"}
    assert again.record.findings == [told]
    assert json.loads(path.read_text())["counts"] == {"kill build": {"trials": 1, "killed": 1}}
    assert plan(4).record.counts == {}
