"""docs/stories.md shows the controller and the table of the kept trials; its commands exist."""

import re
import shlex
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "stories.md").read_text()
EXAMPLE = ROOT / "examples" / "insertion"
LARGEST_BYTES = 3_000_000


def test_the_page_shows_the_controller():
    (shown,) = re.findall(r"^```py\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert shown in (EXAMPLE / "methods.py").read_text()


def test_the_table_is_that_of_the_kept_trials():
    pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'tactile-loc[sim]'")
    from records import format_table, read_records
    from trials import list_trials

    trials = list_trials(100)
    kept = read_records(EXAMPLE / "kept" / "trials.jsonl", trials)
    assert sorted(kept) == [trial.number for trial in trials]
    assert format_table([record for number in sorted(kept) for record in kept[number]]) in PAGE


def test_the_commands_of_the_page_have_valid_arguments():
    pytest.importorskip("matplotlib")
    from run import parse_arguments

    blocks = re.findall(r"^```bash\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.split("\n")]
    commands = [shlex.split(line) for line in lines if line.startswith("python ")]
    assert commands
    for _, script, *arguments in commands:
        assert (ROOT / script).exists()
        parse_arguments(arguments)


def test_the_pictures_are_small_enough():
    for name in re.findall(r"\((images/insertion[^)]*)\)", PAGE):
        path = ROOT / "docs" / name
        assert path.stat().st_size < LARGEST_BYTES
        assert Image.open(path).width > 300
