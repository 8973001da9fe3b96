"""docs/stories.md shows the controller and the table of the kept trials; its commands exist."""

import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "stories.md").read_text()
EXAMPLE = ROOT / "examples" / "insertion"


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
