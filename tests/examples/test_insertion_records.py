"""examples/insertion: records are kept, read again, completed after an interruption, and summarised."""

import json

import pytest

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'tactile-loc[sim]'")

import run
from experiment import Record
from methods import METHODS
from records import NAME, RecordsError, append_records, format_table, read_records
from trials import list_trials

TRIALS = list_trials(3)


def make_records(trial, success=True):
    number, part, clearance_mm, seed = trial.number, trial.part, trial.clearance_mm, trial.seed
    measured = (success, "inserted", 2.0, 2, ["nominal"], 3.0, 18.0, {"tip_mm": 0.1}, 0.2, ["certain"])
    return [Record(number, part, clearance_mm, seed, method, *measured) for method in METHODS]


class FakeExperiment:
    """Counts the trials that it runs; it is interrupted in the trial `fails`."""

    def __init__(self, *_):
        pass

    def run(self, trial):
        type(self).ran.append(trial.number)
        if trial.number == type(self).fails:
            raise KeyboardInterrupt
        return make_records(trial)


@pytest.fixture
def experiment(monkeypatch):
    monkeypatch.setattr("experiment.Experiment", FakeExperiment)
    FakeExperiment.ran, FakeExperiment.fails = [], None
    return FakeExperiment


def test_records_are_read_as_they_were_written_without_an_unfinished_line(tmp_path):
    path = tmp_path / NAME
    append_records(path, make_records(TRIALS[0]))
    assert {record["method"] for record in json.loads(path.read_text())} == set(METHODS)
    with path.open("a") as file:
        file.write('[{"trial": 1, "part"')
    assert list(read_records(path, TRIALS)) == [0]
    for trial in TRIALS[1:]:
        append_records(path, make_records(trial))
    assert read_records(path, TRIALS) == {trial.number: make_records(trial) for trial in TRIALS}
    assert list(read_records(path, TRIALS[:1])) == [0]


def test_damaged_records_and_those_of_other_seeds_are_refused(tmp_path):
    path = tmp_path / NAME
    append_records(path, make_records(TRIALS[0]))
    with pytest.raises(RecordsError, match="line 1"):
        read_records(path, list_trials(3, first_seed=500))
    path.write_text("nonsense\n")
    with pytest.raises(RecordsError, match="line 1"):
        read_records(path, TRIALS)


def test_an_interrupted_command_continues_with_the_trial_that_was_lost(tmp_path, experiment, capsys):
    arguments = ["--trials", "3", "--out", str(tmp_path)]
    experiment.fails = 1
    assert run.main(arguments) == 130
    experiment.fails = None
    assert run.main(arguments) == 0
    assert experiment.ran == [0, 1, 1, 2]
    assert run.main(arguments) == 0
    assert experiment.ran == [0, 1, 1, 2]
    printed = capsys.readouterr()
    assert printed.out.count("| verdict | 3 of 3 |") == 2
    assert "3 of 3 trials" in printed.err


def test_the_table_counts_successes_by_method_and_part():
    records = [r for k, trial in enumerate(TRIALS) for r in make_records(trial, success=k > 0)]
    table = format_table(records)
    assert table.count("2 of 3") == len(METHODS)
    assert "| 0 of 1 | 1 of 1 | 1 of 1 |" in table
