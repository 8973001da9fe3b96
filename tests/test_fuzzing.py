"""A short run of the fuzzer, and tests of its checks."""

import dataclasses
import json
import os
import time
from pathlib import Path

import fuzz
import pytest
from fuzzing import trial
from fuzzing.readers import READERS, Reader
from record import Record

from tactile_loc.core.runtime.errors import ConfigError

PAGES = ["result", "evaluation", "sweep", "touch-png", "artifact"]
OTHERS = [name for name in READERS if name not in PAGES]


@pytest.mark.slow
@pytest.mark.parametrize(("chosen", "inputs"), [(OTHERS, 12), (PAGES, 3)], ids=["files", "pages"])
def test_damaged_inputs_are_read_or_refused_in_one_sentence(tmp_path, chosen, inputs):
    for library in ("mcap", "rosbags", "safetensors", "pyarrow"):
        pytest.importorskip(library)
    state = Record(tmp_path / "state.json", 0)
    fuzz.fuzz(chosen, state, inputs, 0, tmp_path)
    assert {name: found for name in chosen if (found := fuzz.select_findings(state.of(name)))} == {}
    assert all(sum(state.of(name)[outcome] for outcome in (trial.READ, trial.REFUSED)) == inputs for name in chosen)
    assert sum(state.of(name)[trial.READ] for name in chosen) > 0.05 * inputs * len(chosen)


def refuse(text, cause=None):
    def read(folder):
        raise ConfigError(text.format(folder)) from cause

    return read


@pytest.mark.parametrize(
    ("read", "outcome"),
    [
        (lambda folder: None, trial.READ),
        (refuse("{}/part.toml is no table"), trial.REFUSED),
        (refuse("something is wrong"), "says not where"),
        (refuse(""), "no sentence"),
        (refuse("{}/part.toml cannot be read", MemoryError()), "memory"),
        (lambda folder: [][1], "IndexError"),
        (lambda folder: time.sleep(60), "TooLongError"),
        (lambda folder: (folder / "../escaped").write_text("x"), "writes elsewhere"),
    ],
)
def test_a_reader_is_judged_by_what_it_does(tmp_path, monkeypatch, read, outcome):
    monkeypatch.setattr(trial, "SECONDS", 0.5 if outcome == "TooLongError" else 60)
    folder = tmp_path / "sandbox" / "input"
    folder.mkdir(parents=True)
    (folder / "part.toml").write_text("a = 1\n")
    found, details = trial.judge(Reader("broken", lambda _: None, read, names_file=True), folder)
    assert found.startswith(outcome)
    assert outcome != "IndexError" or "list index out of range" in details


def test_a_dead_process_is_a_finding_and_fuzzing_continues(tmp_path, monkeypatch):
    def verdicts(jobs, seed, out):
        if jobs[0] == ("mount", 0):
            yield "dies (-9)", ""
            return
        yield from ((trial.READ, "") for _ in jobs)

    monkeypatch.setattr(fuzz, "_read_inputs", verdicts)
    state = Record(tmp_path / "state.json", 3)
    fuzz.fuzz(["mount"], state, 5, 0, tmp_path)
    assert state.of("mount") == {"inputs": 5, "dies (-9)": 1, trial.READ: 4}
    assert fuzz.select_findings(state.of("mount")) == {"dies (-9)": 1}
    told = json.loads((tmp_path / "findings" / "mount-0" / "finding.json").read_text())
    assert told == {"reader": "mount", "seed": 3, "number": 0, "outcome": "dies (-9)"}
    assert Record.open(tmp_path / "state.json", 3) == state, "the same seed continues the record"
    assert Record.open(tmp_path / "state.json", 4).counts == {}, "another seed starts a new record"


@pytest.mark.slow
def test_a_relative_output_folder_works_for_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert fuzz.main(["sensor", "--inputs", "0", "--commands", "1", "--out", "kept"]) == 0
    assert Record.open(tmp_path / "kept/state.json", 0).of("sensor")["commands"] == 1


@pytest.mark.slow
def test_no_names_mean_all_readers(tmp_path, capsys):
    assert fuzz.main(["--inputs", "0", "--commands", "0", "--out", str(tmp_path)]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(READERS)
    with pytest.raises(SystemExit) as refused:
        fuzz.main(["no-such-reader"])
    assert refused.value.code == 2
    assert "no-such-reader" in capsys.readouterr().err


def test_the_seed_and_the_number_determine_the_input(tmp_path):
    chosen = dataclasses.replace(READERS["touch-npz"], fuzzed=("*",))
    whole = tmp_path / "whole"
    whole.mkdir()
    chosen.write(whole)

    def made(name: str, seed: int, number: int) -> dict[str, bytes]:
        trial.make_input(chosen, whole, tmp_path / name, seed, number)
        return {path.name: path.read_bytes() for path in Path(tmp_path / name).iterdir()}

    first = [made(f"a{n}", 1, n) for n in range(20)]
    assert [made(f"b{n}", 1, n) for n in range(20)] == first
    assert [made(f"c{n}", 2, n) for n in range(20)] != first
    assert all(set(files) == set(os.listdir(whole)) for files in first)
