"""The commands, links, limits and the table of arrays in docs/reports.md match the code."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.result_arrays import MOST_FACES, MOST_POSES, pack_arrays

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "reports.md").read_text()


def commands() -> list[list[str]]:
    lines = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
    return [shlex.split(line, comments=True) for line in lines if line]


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_every_command_on_the_page_is_valid(words):
    from tactile_loc_cli.main import app

    assert words[0] == "tactile-loc"
    command = get_command(app).commands[words[1]]
    command.make_context(words[1], words[2:])  # raises on an option that does not exist


def test_the_page_contains_only_shell_blocks():
    assert re.findall(r"^```(\w+)", PAGE, re.MULTILINE) == ["sh"]


def test_pictures_and_links_exist():
    targets = re.findall(r"\]\(([^)#]+)\)", PAGE)
    assert len(targets) >= 4
    for target in targets:
        assert (ROOT / "docs" / target).exists(), target


def test_the_table_lists_the_arrays_of_the_file(store):
    localizer = Localizer.create("pin", store=store, grid={"name": "face", "spacing_mm": 8})
    localization = localizer.localize(localizer.simulate(1)[0])
    written = {
        "schema_version",
        "result_sha256",
        *pack_arrays(localization.posterior, localization.touches),
    }
    rows = re.findall(r"^\| (`[^|]*) \| ([^|]*) \|", PAGE, re.MULTILINE)
    named = {name: meaning for names, meaning in rows for name in re.findall(r"`(\w+)`", names)}
    assert written == {name for name, meaning in named.items() if "optional" not in meaning}
    assert set(named) - written == {"touch_0_observed", "touch_0_image", "log_train", "left_out_0_depth_m"}


def test_the_limits_match_the_code():
    text = PAGE.replace("\n", " ")
    assert f"{MOST_POSES:,} poses".replace(",", " ") in text
    assert f"{MOST_FACES:,} triangles".replace(",", " ") in text


def test_the_python_names_exist(tmp_path):
    import tactile_loc.reports as reports

    assert callable(reports.write_report)
    assert callable(reports.find_source)
    assert np.size(re.findall(r"write_report\(find_source\(", PAGE)) == 1
