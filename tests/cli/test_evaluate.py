"""`tactile-loc evaluate`: what `run` answers, from simulated and own touches."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import TINY, assert_refused, succeed
from tactile_loc_cli.evaluate.jobs import Asked, choose_options

from tactile_loc.core.geometry.rigid import rotation_to_quaternion
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.evaluation.recall import evaluation
from tactile_loc.slots.registry import Registry

SEARCH = ["-o", "grid.directions=300", "-o", "temperature=0.05"]
OWN = ["--object", "pin", *TINY, "--refiner", "none"]
FILES = {"recall.json", "recall.csv", "recall.md"}


@pytest.mark.slow
def test_results_of_noises_and_numbers_of_touches_are_written(cli, tmp_path):
    words = ["--object", "hook", "--count", 2, "--together", "1..2", "--noise", "none", "--noise", "mild"]
    done = succeed(cli("evaluate", *words, "--seed", 2, "--seed", 3, *SEARCH))
    out = tmp_path / "evaluation"
    assert {path.name for path in out.iterdir()} == FILES
    record = json.loads((out / "recall.json").read_text())
    assert record["protocol"]["together"] == [1, 2]
    runs = [("none", 2), ("none", 3), ("mild", 2), ("mild", 3)]
    assert [(run["noise"], run["seed"]) for run in record["runs"]] == runs
    assert record["runs"][0]["configuration"]["grid"]["name"] == "whole"
    with (out / "recall.csv").open() as file:
        rows = list(csv.DictReader(file))
    groups = [("none", "1", "4"), ("none", "2", "4"), ("mild", "1", "4"), ("mild", "2", "4")]
    assert [(row["noise"], row["touches"], row["examples"]) for row in rows] == groups
    assert "recall.json" in done.stdout
    assert cli("report", "evaluation").exit_code == 0
    again = cli("evaluate", *words, "--seed", 2, "--seed", 3, *SEARCH, "--out", "again")
    assert again.exit_code == 0
    assert (tmp_path / "again" / "recall.csv").read_text() == (out / "recall.csv").read_text()


def test_touches_of_simulate_are_evaluated(cli, tmp_path):
    assert cli("simulate", "--object", "pin", "--count", 3, "--out", "touches", *TINY).exit_code == 0
    (tmp_path / "touches" / "touch-0001.npz").write_bytes(b"")
    assert_refused(cli("evaluate", "--touches", "touches", "--out", "out"), "--object")
    done = succeed(cli("evaluate", *OWN, "--touches", "touches", "--out", "out"))
    assert "touch-0001.npz" in done.stdout
    record = json.loads((tmp_path / "out" / "recall.json").read_text())
    (run,) = record["runs"]
    (result,) = record["summary"]
    assert (result["touches"], result["examples"], result["verdicts"]["refused"]) == (1, 3, 1)
    assert (run["noise"], run["seed"]) == ("own touches", None)
    errors = record["examples"]["first mssd_m"]
    assert [error is None for error in errors] == [False, True, False]


def test_an_evaluation_without_a_readable_touch_is_refused(cli, tmp_path):
    """The touches are of another sensor, so their size does not fit."""
    simulated = ["simulate", "--object", "pin", "--sensor", "digit", "--count", 2, "--out", "touches", *TINY]
    assert cli(*simulated).exit_code == 0
    done = cli("evaluate", *OWN, "--touches", "touches", "--out", "out")
    assert_refused(done, "2 examples", "touch-0000.npz", "320 x 240")
    assert not (tmp_path / "out").exists()


def test_a_table_of_own_touches_is_evaluated_together(cli, tmp_path):
    assert cli("simulate", "--object", "pin", "--count", 2, "--out", "touches", *TINY).exit_code == 0
    poses = json.loads((tmp_path / "touches" / "poses.json").read_text())["T_sensor_object"]
    header = "touch,x_mm,y_mm,z_mm,qw,qx,qy,qz,example"
    rows = []
    for name, T in poses.items():
        numbers = [*(1e3 * np.array(T)[:3, 3]), *rotation_to_quaternion(np.array(T)[:3, :3])]
        rows.append(f"{name}.npz,{','.join(map(str, numbers))},one")
    Path("touches/poses.csv").write_text("\n".join([header, *rows]))
    words = [*OWN, "--touches", "touches/poses.csv", "--out", "out"]
    succeed(cli("evaluate", *words))
    record = json.loads((tmp_path / "out" / "recall.json").read_text())
    assert [result["touches"] for result in record["summary"]] == [1, 2]
    assert_refused(cli("evaluate", *words, "--together", "3"), "3 touches")


def test_an_interruption_is_one_line_and_resumes_and_json_has_no_single_examples(cli, tmp_path, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    line = ["evaluate", *OWN, "--count", 1, "--together", "1", "--noise", "none", "--seed", 77]
    with monkeypatch.context() as patched:
        patched.setattr(evaluation._ExampleLocator, "_locate", interrupt)
        stopped = cli(*line)
    assert stopped.exit_code == 130
    assert stopped.stderr.startswith("interrupted: ")
    assert not (tmp_path / "evaluation" / "recall.json").exists()
    said = json.loads(succeed(cli(*line, "--json")).stdout)
    stored = json.loads((tmp_path / "evaluation" / "recall.json").read_text())
    assert said["summary"] == stored["summary"] != []
    assert "examples" in stored
    assert "examples" not in said


def test_an_encoder_option_goes_only_to_encoders_that_have_it(monkeypatch):
    class Learned:
        class Options(ComponentOptions):
            epochs: int = 3

    load = Registry.load
    monkeypatch.setattr(
        Registry, "load", lambda self, slot, name: Learned if name == "learned" else load(self, slot, name)
    )
    words = ["grid.spacing_mm=8", "encoder.epochs=1", "encoder.cells=9", "encoder.nonsense=1"]
    overrides = {"epochs": 1, "cells": 9, "nonsense": 1}
    both = ["pixel", "learned"]
    assert choose_options("pixel", both, words, overrides) == [words[0], *words[2:]]
    assert choose_options("learned", both, words, overrides) == [*words[:2], words[3]]
    assert choose_options("pixel", ["pixel"], words, overrides) == words


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("1..7", (1, 2, 3, 4, 5, 6, 7)), ("3", (3,)), ("1, 2,5", (1, 2, 5)), ("5,1..2,2", (1, 2, 5)), ("20..20", (20,))],
)
def test_ranges_and_lists_of_contacts_are_parsed(text, numbers):
    assert Asked(together=text).numbers == numbers


@pytest.mark.parametrize("text", ["", "0", "7..1", "1..21", "1-7", "one", "1,,2", "1..", "-1", "1.5", "0..3"])
def test_malformed_numbers_of_contacts_are_refused_in_one_sentence(cli, text):
    assert_refused(cli("evaluate", f"--together={text}", "--object", "pin", *TINY), "--together", "1..7")


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        ("--object hok", ["hok"]),
        ("--object pin --noise loud", ["loud"]),
        ("--object pin --touches none.csv", ["none.csv"]),
        ("--object pin --touches file --noise mild", ["--noise", "--touches"]),
        ("--object pin --touches file --count 2", ["--count"]),
        ("--object pin --touches file --seed 0", ["--seed"]),
        ("--object pin --object hook --touches file", ["one --object"]),
        ("--object pin --out file", ["--out"]),
    ],
)
def test_bad_input_is_one_sentence(cli, tmp_path, words, mentioned):
    (tmp_path / "file").touch()
    assert_refused(cli("evaluate", *words.split(), *TINY), *mentioned)
