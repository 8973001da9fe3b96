"""docs/tuning.md lists every tunable option with its default and its effect, and its examples work."""

from __future__ import annotations

import re
from typing import Any

import pytest
import tuning

from tactile_loc.io.config import RunConfig
from tactile_loc.io.options import TUNABLE

PAGE = tuning.PAGE.read_text(encoding="utf-8")


def test_the_tables_are_up_to_date():
    assert [marker[1] for marker in tuning.MARKER.finditer(PAGE)] == list(TUNABLE)
    assert tuning.with_tables(PAGE) == PAGE, "run python docs/tuning.py"


def test_every_option_has_an_effect():
    effects = tuning.read_effects(PAGE)
    assert set(effects) == tuning.options()
    assert [option for option, effect in effects.items() if not effect] == []


def test_options_named_in_the_text_exist():
    named = set(re.findall(rf"`((?:{'|'.join(TUNABLE)})\.\w+)`", PAGE))
    assert named == tuning.options()


@pytest.mark.parametrize(
    ("before", "after"),
    [("| `search.registered` | 150 |", "| `search.registered` | 151 |"), ("| >= 1 |", "| >= 2 |")],
)
def test_a_changed_table_cell_is_restored(before, after):
    assert before in PAGE
    assert tuning.with_tables(PAGE.replace(before, after)) == PAGE


def test_an_effect_of_a_removed_option_is_not_lost(tmp_path, monkeypatch):
    page = tmp_path / "tuning.md"
    page.write_text(PAGE.replace("`tracker.modes` | 5", "`tracker.poses` | 5"), encoding="utf-8")
    monkeypatch.setattr(tuning, "PAGE", page)
    with pytest.raises(SystemExit, match=r"tracker\.poses"):
        tuning.main()
    assert "tracker.poses" in page.read_text(encoding="utf-8")


def test_the_python_on_the_page_runs(monkeypatch, store):
    (code,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["localizer"].config.search.registered == 500
    assert names["localizer"].config.hypotheses.refined == 30


def test_the_configuration_on_the_page_can_be_read(tmp_path):
    (text,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    (tmp_path / "run.toml").write_text(text)
    config = RunConfig.from_toml(tmp_path / "run.toml")
    assert (config.search.registered, config.hypotheses.refined) == (500, 30)
