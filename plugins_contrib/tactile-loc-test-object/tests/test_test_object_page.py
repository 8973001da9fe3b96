"""docs/test-object.md, the README and the commands."""

import json
import re
from pathlib import Path

import PIL.Image
import pytest
from cli_helpers import assert_one_error, succeed
from page_helpers import list_commands, read_page

README = Path(__file__).parents[1] / "README.md"


def run_program(text: str, name: str) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(compile(program, name, "exec"), {})


@pytest.fixture
def score_words(cli, monkeypatch, store_folder) -> list[str]:
    """The words of the page's command that scores the photos, after its other command and its program ran."""
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store_folder))
    page = read_page("test-object.md")
    make, *_, score = list_commands(page)
    succeed(cli(*make[1:]))
    run_program(page, "test-object.md")
    return list(score[1:])


@pytest.mark.slow
def test_the_commands_of_the_page_make_and_score_the_object(cli, score_words):
    assert {path.name for path in Path("object").iterdir()} == {"test-object.stl", "places.csv", "drawing.png"}
    PIL.Image.new("L", (7, 7)).save("photos/3b.png")
    said = json.loads(succeed(cli(*score_words, "--json")).stdout)
    assert said["row"]["located"] == 10
    assert said["row"]["photos"] == 11
    assert said["row"]["score"] > 85
    assert [one["state"] for one in said["presses"]].count("refused") == 1
    assert json.loads(Path("score/row.json").read_text()) == said["row"]
    html = Path("score/report.html").read_text()
    assert html.count("<img") == 30


@pytest.mark.slow
def test_photos_with_wrong_numbers_are_named(cli, score_words):
    for old, new in (("3", "a"), ("4", "3"), ("a", "4")):
        Path(f"photos/{old}.npz").rename(f"photos/{new}.npz")
    done = cli(*score_words, "--json")
    said = json.loads(succeed(done).stdout)
    assert said["row"]["located"] == 8
    assert said["row"]["height_scale"] == pytest.approx(1, abs=0.02)
    assert "warning: 3.npz, 4.npz fit no pose at their places" in done.stderr


@pytest.mark.slow
def test_the_readmes_program_runs(cli, monkeypatch, store_folder, capsys):
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store_folder))
    run_program(README.read_text(), "README.md")
    assert "2 of 2 photos located" in capsys.readouterr().out


@pytest.mark.parametrize("words", [("photos",), ("photos", "--sensor", "gelsight-mini")])
def test_a_missing_sensor_or_folder_is_one_sentence(cli, words):
    done = cli("test-object", "score", *words)
    assert_one_error(done.stderr, done.exit_code)
    assert not Path("tactile-loc-test-object").exists()
