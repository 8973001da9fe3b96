"""`tactile-loc evaluate --paper`."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest
from cli_helpers import FLAT_SENSOR, TINY, assert_refused, succeed, write_box
from PIL import Image
from tactile_loc_cli.evaluate.jobs import Asked, choose_options, list_jobs
from tactile_loc_cli.evaluate.paper import choose_touches

from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.evaluation.simulated_touches import SimulatedTouches

FEW = ["--paper", "--count", 3, "--refiner", "none", *TINY]


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pictures")
def test_results_of_several_objects_are_written(cli, tmp_path):
    done = succeed(cli("evaluate", "--object", "pin", "--object", "head", "--seed", 2, *FEW))
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
    succeed(cli("evaluate", "--object", "pin", "--images", "--sensor", "mine", *FEW))
    record = json.loads((tmp_path / "evaluation" / "results.json").read_text())
    assert record["protocol"] == {"version": 3, "touches": 3, "noise": "none", "seed": 0, "images": True}
    assert re.search(r"\b3 simulated touches\b.*images", (tmp_path / "evaluation" / "results.md").read_text())


@pytest.mark.slow
def test_a_repeated_command_gives_the_same_table(cli, tmp_path):
    tables = []
    for out in ("a", "b"):
        assert cli("evaluate", "--object", "pin", *FEW, "--noise", "mild", "--out", out).exit_code == 0
        tables.append((tmp_path / out / "results.csv").read_text())
    assert tables[0] == tables[1]


def test_an_interruption_is_one_line_and_resumes(cli, tmp_path, monkeypatch):
    from tactile_loc.evaluation.protocol import TouchEvaluator

    def interrupt(*arguments):
        raise KeyboardInterrupt

    line = ["evaluate", "--object", "pin", *FEW, "--noise", "none", "--seed", 77]
    with monkeypatch.context() as patched:
        patched.setattr(TouchEvaluator, "measure", interrupt)
        stopped = cli(*line)
    assert stopped.exit_code == 130
    assert stopped.stderr.startswith("interrupted: ")
    assert not (tmp_path / "evaluation" / "results.json").exists()
    assert cli(*line).exit_code == 0


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
    from tactile_loc_cli.options import RunOptions

    touches = choose_touches(RunOptions(), Asked(None, None, None, None, (), False, (), (5,), Path("out"), None))
    assert touches == SimulatedTouches("strong", 5)
    jobs = list_jobs(RunOptions(), None, None, touches)
    assert [obj.name for _, obj in jobs] == list(DEMO_OBJECTS)
    assert {settings.encoder.name for settings, _ in jobs} == {"pixel"}
    assert {settings.touch.noise for settings, _ in jobs} == {"strong"}


def test_an_encoder_option_goes_only_to_encoders_that_have_it(monkeypatch):
    from tactile_loc.core.runtime.options import ComponentOptions
    from tactile_loc.slots.registry import Registry

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
    ("words", "mentioned"),
    [
        (["--object", "hok"], ("hok",)),
        (["--object", "pin", "--encoder", "pixl"], ("pixl",)),
        (["--object", "pin", "--object", "hook", "--symmetry", "none"], ("--symmetry",)),
        (["--object", "pin", "--noise", "loud"], ("loud",)),
        (["--object", "pin", "--count", "0"], ("count",)),
        (["--object", "pin", "-o", "encoder.sells=3"], ("sells",)),
        (["--object", "pin", "--config", "none.toml"], ("none.toml",)),
        (["--object", "pin", "--out", "file"], ("--out",)),
        (["--object", "pin", "--images"], ("gelslim", "calibrate --simulated")),
        (["--object", "pin", "--images", "--noise", "mild"], ("'mild'", "--noise")),
        (["--object", "pin", "--noise", "mild", "--noise", "none"], ("--noise",)),
        (["--object", "pin", "--seed", "1", "--seed", "2"], ("--seed",)),
        (["--object", "a/part.obj", "--object", "b/part.obj", "--units", "mm"], ("a/part.obj", "b/part.obj", "part")),
    ],
)
def test_bad_input_is_one_sentence(cli, tmp_path, words, mentioned):
    (tmp_path / "file").touch()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_box(tmp_path / folder / "part.obj")
    assert_refused(cli("evaluate", "--paper", *words, *TINY), *mentioned)
