"""`tactile-loc paper`: the errors that the paper reports, from one touch and by number of contacts."""

import csv
import json
from pathlib import Path

import pytest
from cli_helpers import TINY, assert_refused, succeed, write_box
from PIL import Image
from tactile_loc_cli.evaluate import paper
from tactile_loc_cli.evaluate.jobs import Asked, list_jobs
from tactile_loc_cli.options import RunOptions

from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.evaluation.paper import fusion
from tactile_loc.evaluation.paper.fusion import FUSION_VERSION
from tactile_loc.evaluation.paper.tables import PUBLISHED
from tactile_loc.evaluation.protocol import PROTOCOL_VERSION, TouchEvaluator
from tactile_loc.evaluation.simulated_touches import SimulatedTouches

FEW = ["--count", 3, "--refiner", "none", *TINY]
DRAWN = {"noise": "strong", "seed": 2, "renderer": None}


@pytest.mark.usefixtures("drawn_pictures")
def test_one_command_writes_all_results_beside_those_of_the_paper(cli, tmp_path):
    done = succeed(cli("paper", "--object", "pin", "--object", "hook", "--seed", 2, *FEW))
    out = tmp_path / "paper"
    galleries = {"gallery-pin-pixel.png", "gallery-hook-pixel.png"}
    pictures = {"violins.png", "reliability.png", "contacts.png", *galleries}
    texts = {f"{name}.{kind}" for name in ("paper", "results", "contacts") for kind in ("json", "csv", "md")}
    assert {path.name for path in out.iterdir()} == {*texts, *pictures}
    records = {name: json.loads((out / f"{name}.json").read_text()) for name in ("paper", "results", "contacts")}
    contacts = [1, 2, 3, 4, 5, 6, 7]
    assert records["paper"]["protocol"] == {"touches": 3, "examples": 3, "contacts": contacts, **DRAWN, "quick": []}
    assert records["results"]["protocol"] == {"version": PROTOCOL_VERSION, "touches": 3, **DRAWN}
    assert records["contacts"]["protocol"] == {"version": FUSION_VERSION, "contacts": contacts, "examples": 3, **DRAWN}
    for name in ("results", "contacts"):
        assert [run["object"] for run in records[name]["runs"]] == ["pin", "hook"]
        configuration = records[name]["runs"][0]["configuration"]
        assert configuration["grid"]["options"]["spacing_mm"] == 8
        assert configuration["touch"]["noise"] == "strong"
        with (out / f"{name}.csv").open() as file:
            assert {row["object"] for row in csv.DictReader(file)} == {"pin", "hook"}
    for name in pictures:
        with Image.open(out / name) as picture:
            assert min(picture.size) > 250
        assert name in done.stdout
    in_mm, measured, published, best, *_ = [w for w in map(str.split, done.stdout.splitlines()) if w[:1] == ["pin"]]
    first = records["results"]["summary"][0]
    assert float(in_mm[2]) == pytest.approx(1e3 * first["median_m"], rel=0.01)
    assert measured[2:4] == ["measured", f"{first['median_normalised']:.3f}"]
    assert published[2:4] == ["paper", f"{PUBLISHED['pin']['best-1']:.2f}"]
    assert float(best[9]) == pytest.approx(records["contacts"]["summary"][6]["median_normalised"], abs=1e-3)


@pytest.mark.parametrize(
    ("place", "step", "seed"),
    [(TouchEvaluator, "measure", 77), (fusion._FusedExamples, "_locate_example", 78)],
    ids=["one", "several"],
)
def test_an_interruption_is_one_line_and_the_same_command_resumes(cli, tmp_path, monkeypatch, place, step, seed):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    line = ["paper", "--object", "pin", *FEW, "--noise", "none", "--seed", seed]
    with monkeypatch.context() as patched:
        patched.setattr(place, step, interrupt)
        stopped = cli(*line)
    assert stopped.exit_code == 130
    assert stopped.stderr.startswith("interrupted: ")
    assert not (tmp_path / "paper" / "paper.json").exists()
    if place is not TouchEvaluator:  # the single touches are located already
        monkeypatch.setattr(TouchEvaluator, "measure", interrupt)
    said = json.loads(succeed(cli(*line, "--json")).stdout)
    for where, method in ((TouchEvaluator, "measure"), (fusion._FusedExamples, "_locate_example")):
        monkeypatch.setattr(where, method, interrupt)
    again = json.loads(succeed(cli(*line, "--json", "--out", "again")).stdout)
    stored = json.loads((tmp_path / "paper" / "paper.json").read_text())
    assert said["summary"] == again["summary"] == stored["summary"] != []


def test_a_configuration_file_gives_object_noise_and_encoder(cli, tmp_path):
    (tmp_path / "run.toml").write_text(
        '[object]\npath = "pin"\n[touch]\nnoise = "mild"\n[grid]\nspacing_mm = 8\n'
        '[encoder]\nname = "pixel"\ncells = 12\n'
    )
    succeed(cli("paper", "--config", "run.toml", "--count", 1, "--refiner", "none"))
    record = json.loads((tmp_path / "paper" / "results.json").read_text())
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


@pytest.mark.parametrize(
    ("quick", "count", "words", "counts", "changed"),
    [
        (False, None, [], (paper.TOUCHES, paper.EXAMPLES), 0),
        (False, 7, [], (7, 7), 0),
        (True, None, [], (paper.QUICK_TOUCHES, paper.QUICK_EXAMPLES), 3),
        (True, 7, [], (7, 7), 1),
        (True, None, ["grid.spacing_mm = 2"], (paper.QUICK_TOUCHES, paper.QUICK_EXAMPLES), 2),
    ],
)
def test_quick_changes_only_what_is_not_given_and_says_so(quick, count, words, counts, changed):
    plan = paper._make_plan(RunOptions(option=words), Asked(count=count), quick, Path())
    assert ((plan.touches, plan.examples), len(plan.changes)) == (counts, changed)


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        ("--object pin --encoder pixl", ["pixl"]),
        ("--object pin --object hook --symmetry none", ["--symmetry"]),
        ("--object pin --count 0", ["count"]),
        ("--object pin -o encoder.sells=3", ["sells"]),
        ("--object pin --config none.toml", ["none.toml"]),
        ("--object pin --noise mild --noise none", ["--noise"]),
        ("--object pin --seed 1 --seed 2", ["--seed"]),
        ("--object pin --out file", ["--out"]),
        ("--object a/part.obj --object b/part.obj --units mm", ["a/part.obj", "b/part.obj", "part"]),
    ],
)
def test_bad_input_is_one_sentence(cli, tmp_path, words, mentioned):
    (tmp_path / "file").touch()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_box(tmp_path / folder / "part.obj")
    assert_refused(cli("paper", *words.split(), *TINY), *mentioned)
