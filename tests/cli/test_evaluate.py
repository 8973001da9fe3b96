"""`tactile-loc evaluate`: what `run` answers, from simulated and own touches, and the paper's protocol."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import FLAT_SENSOR, TINY, assert_refused, succeed, write_box
from PIL import Image
from tactile_loc_cli.evaluate import paper
from tactile_loc_cli.evaluate.jobs import Asked, choose_options, list_jobs
from tactile_loc_cli.options import RunOptions

from tactile_loc.core.geometry.rigid import rotation_to_quaternion
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.evaluation import fusion
from tactile_loc.evaluation.protocol import TouchEvaluator
from tactile_loc.evaluation.recall import evaluation
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.slots.registry import Registry

SEARCH = ["-o", "grid.directions=300", "-o", "temperature=0.05"]
OWN = ["--object", "pin", *TINY, "--refiner", "none"]
PAPER = ["--paper", "--count", 3, "--refiner", "none", *TINY]
FILES = {"recall.json", "recall.csv", "recall.md", "recall.png", "bop"}


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
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
    with Image.open(out / "recall.png") as picture:
        assert min(picture.size) > 300
    assert len(list((out / "bop").glob("*.csv"))) == 2
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


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
def test_results_of_several_objects_are_written(cli, tmp_path):
    done = succeed(cli("evaluate", "--object", "pin", "--object", "head", "--seed", 2, *PAPER))
    out = tmp_path / "evaluation"
    pictures = {"violins.png", "reliability.png", "gallery-pin-pixel.png", "gallery-head-pixel.png"}
    assert {path.name for path in out.iterdir()} == {"results.json", "results.csv", "results.md", *pictures}
    record = json.loads((out / "results.json").read_text())
    assert record["protocol"] == {"version": 3, "touches": 3, "noise": "strong", "seed": 2, "images": False}
    assert [run["object"] for run in record["runs"]] == ["pin", "head"]
    configuration = record["runs"][0]["configuration"]
    assert configuration["grid"]["options"]["spacing_mm"] == 8
    assert configuration["touch"]["noise"] == "strong"
    with (out / "results.csv").open() as file:
        assert {row["object"] for row in csv.DictReader(file)} == {"pin", "head"}
    for name in pictures:
        with Image.open(out / name) as picture:
            assert min(picture.size) > 300
    lines = [line.split() for line in done.stdout.splitlines()]
    median_m = record["summary"][0]["median_m"]
    in_mm, shares, ambiguity, area, trust = [line for line in lines if line[:2] == ["pin", "pixel"]]
    assert float(in_mm[2]) == pytest.approx(1e3 * median_m, rel=0.01)
    assert float(shares[2]) == pytest.approx(median_m / record["runs"][0]["random_mean_m"]["add"], abs=1e-3)
    assert ambiguity[2] == f"{100 * record['runs'][0]['ambiguous']:.0f}"
    assert int(area[2]) == record["runs"][0]["refused"]
    assert trust[2::2][:3] == [f"{100 * share:.0f}" for share in record["runs"][0]["coverage"]]
    assert max(map(len, done.stdout.splitlines()[:4])) <= 80
    for name in ("results.json", *pictures):
        assert name in done.stdout


@pytest.mark.slow
def test_images_are_evaluated_with_a_calibrated_sensor(cli, tmp_path):
    (tmp_path / "sensor.toml").write_text(FLAT_SENSOR)
    learn = ["--estimator", "photometric", "--presses", 20, "-o", "steps=200"]
    succeed(cli("calibrate", "--simulated", "--sensor", "sensor.toml", *learn, "--out", "mine"))
    succeed(cli("evaluate", "--object", "pin", "--images", "--sensor", "mine", *PAPER))
    record = json.loads((tmp_path / "evaluation" / "results.json").read_text())
    assert record["protocol"] == {"version": 3, "touches": 3, "noise": "none", "seed": 0, "images": True}
    assert re.search(r"\b3 simulated touches\b.*images", (tmp_path / "evaluation" / "results.md").read_text())


@pytest.mark.slow
def test_a_repeated_command_gives_the_same_table(cli, tmp_path):
    tables = []
    for out in ("a", "b"):
        assert cli("evaluate", "--object", "pin", *PAPER, "--noise", "mild", "--out", out).exit_code == 0
        tables.append((tmp_path / out / "results.csv").read_text())
    assert tables[0] == tables[1]


@pytest.mark.usefixtures("drawn_pictures")
def test_results_by_number_of_contacts_are_written(cli, tmp_path):
    done = succeed(cli("evaluate", "--together", "1..3", "--object", "pin", "--object", "head", "--seed", 2, *PAPER))
    out = tmp_path / "evaluation"
    assert {path.name for path in out.iterdir()} == {f"contacts.{kind}" for kind in ("json", "csv", "md", "png")}
    record = json.loads((out / "contacts.json").read_text())
    expected = {"version": 2, "contacts": [1, 2, 3], "examples": 3, "noise": "strong", "seed": 2, "images": False}
    assert record["protocol"] == expected
    assert [run["object"] for run in record["runs"]] == ["pin", "head"]
    assert record["runs"][0]["configuration"]["grid"]["options"]["spacing_mm"] == 8
    with (out / "contacts.csv").open() as file:
        assert {row["contacts"] for row in csv.DictReader(file)} == {"1", "2", "3"}
    with Image.open(out / "contacts.png") as picture:
        assert min(picture.size) > 250
    lines = [line.split() for line in done.stdout.splitlines()]
    in_mm, shares = [line for line in lines if line[:3] == ["pin", "pixel", "best-1"]]
    third = record["summary"][2]
    assert (third["object"], third["line"], third["contacts"]) == ("pin", "best-1", 3)
    assert float(in_mm[5]) == pytest.approx(1e3 * third["median_m"], rel=0.01)
    assert float(shares[5]) == pytest.approx(third["median_normalised"], abs=1e-3)
    assert "contacts.png" in done.stdout


@pytest.mark.parametrize(
    ("place", "step", "words", "written"),
    [
        (evaluation._ExampleLocator, "_locate", [*OWN, "--count", 1, "--together", "1"], "recall.json"),
        (TouchEvaluator, "measure", ["--object", "pin", *PAPER], "results.json"),
        (fusion._FusedExamples, "_locate_example", ["--object", "pin", *PAPER, "--together", "2"], "contacts.json"),
    ],
    ids=["answers", "paper", "contacts"],
)
def test_an_interruption_is_one_line_and_resumes_and_json_has_no_single_examples(
    cli, tmp_path, monkeypatch, place, step, words, written
):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    line = ["evaluate", *words, "--noise", "none", "--seed", 77]
    with monkeypatch.context() as patched:
        patched.setattr(place, step, interrupt)
        stopped = cli(*line)
    assert stopped.exit_code == 130
    assert stopped.stderr.startswith("interrupted: ")
    assert not (tmp_path / "evaluation" / written).exists()
    said = json.loads(succeed(cli(*line, "--json")).stdout)
    stored = json.loads((tmp_path / "evaluation" / written).read_text())
    assert said["summary"] == stored["summary"] != []
    assert "examples" in stored
    assert "examples" not in said


def test_a_configuration_file_gives_object_noise_and_encoder(cli, tmp_path):
    (tmp_path / "run.toml").write_text(
        '[object]\npath = "pin"\n[touch]\nnoise = "mild"\n[grid]\nspacing_mm = 8\n'
        '[encoder]\nname = "pixel"\ncells = 12\n'
    )
    assert cli("evaluate", "--paper", "--config", "run.toml", "--count", 1).exit_code == 0
    record = json.loads((tmp_path / "evaluation" / "results.json").read_text())
    (run,) = record["runs"]
    assert (run["object"], record["protocol"]["noise"]) == ("pin", "mild")
    assert run["configuration"]["encoder"]["options"]["cells"] == 12


def test_the_default_is_all_demo_objects():
    touches = paper.choose_touches(RunOptions(), Asked(seed=[5]))
    assert touches == SimulatedTouches("strong", 5)
    jobs = list_jobs(RunOptions(), Asked(), touches)
    assert [obj.name for _, obj in jobs] == list(DEMO_OBJECTS)
    assert {settings.encoder.name for settings, _ in jobs} == {"pixel"}
    assert {settings.touch.noise for settings, _ in jobs} == {"strong"}


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


def test_the_default_is_a_hundred_examples(cli, monkeypatch):
    asked = []
    monkeypatch.setattr(paper, "_evaluate_fusion", lambda *arguments: asked.append(arguments))
    assert cli("evaluate", "--paper", "--together", "1..7", "--object", "pin", *TINY).exit_code == 0
    ((jobs, contacts, plan),) = asked
    assert (len(jobs), contacts, plan.count) == (1, (1, 2, 3, 4, 5, 6, 7), 100)


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
        ("--object pin --images", ["gelslim", "calibrate --simulated"]),
        ("--object pin --touches none.csv", ["none.csv"]),
        ("--object pin --touches file --noise mild", ["--noise", "--touches"]),
        ("--object pin --touches file --count 2", ["--count"]),
        ("--object pin --touches file --seed 0", ["--seed"]),
        ("--object pin --touches file --paper", ["--paper"]),
        ("--object pin --object hook --touches file", ["one --object"]),
        ("--object pin --out file", ["--out"]),
        ("--paper --object pin --encoder pixl", ["pixl"]),
        ("--paper --object pin --object hook --symmetry none", ["--symmetry"]),
        ("--paper --object pin --count 0", ["count"]),
        ("--paper --object pin -o encoder.sells=3", ["sells"]),
        ("--paper --object pin --config none.toml", ["none.toml"]),
        ("--paper --object pin --images --noise mild", ["'mild'", "--noise"]),
        ("--paper --object pin --noise mild --noise none", ["--noise"]),
        ("--paper --object pin --seed 1 --seed 2", ["--seed"]),
        ("--paper --object a/part.obj --object b/part.obj --units mm", ["a/part.obj", "b/part.obj", "part"]),
    ],
)
def test_bad_input_is_one_sentence(cli, tmp_path, words, mentioned):
    (tmp_path / "file").touch()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_box(tmp_path / folder / "part.obj")
    assert_refused(cli("evaluate", *words.split(), *TINY), *mentioned)
