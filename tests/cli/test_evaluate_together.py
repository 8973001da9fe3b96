"""`tactile-loc evaluate --paper --together`."""

from __future__ import annotations

import csv
import json

import pytest
from cli_helpers import TINY, assert_refused, succeed
from PIL import Image
from tactile_loc_cli.evaluate import paper
from tactile_loc_cli.evaluate.command import parse_together

FEW = ["--paper", "--count", 3, "--refiner", "none", *TINY]


@pytest.mark.usefixtures("drawn_pictures")
def test_results_by_number_of_contacts_are_written(cli, tmp_path):
    done = succeed(cli("evaluate", "--together", "1..3", "--object", "pin", "--object", "head", "--seed", 2, *FEW))
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


def test_an_interruption_is_one_line_and_resumes(cli, tmp_path, monkeypatch):
    from tactile_loc.evaluation import fusion

    def interrupt(*arguments):
        raise KeyboardInterrupt

    line = ["evaluate", "--together", "2", "--object", "pin", *FEW, "--seed", 77]
    with monkeypatch.context() as patched:
        patched.setattr(fusion._FusedExamples, "_locate_example", interrupt)
        stopped = cli(*line)
    assert stopped.exit_code == 130
    assert stopped.stderr.startswith("interrupted: ")
    assert not (tmp_path / "evaluation" / "contacts.json").exists()
    assert cli(*line).exit_code == 0


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
    assert parse_together(text) == numbers


@pytest.mark.parametrize("text", ["", "0", "7..1", "1..21", "1-7", "one", "1,,2", "1..", "-1", "1.5", "0..3"])
def test_malformed_numbers_of_contacts_are_refused_in_one_sentence(cli, text):
    assert_refused(cli("evaluate", f"--together={text}", "--object", "pin", *TINY), "--together", "1..7")
