"""docs/plugin-examples.md shows the modules that `tactile-loc new-plugin` writes."""

from __future__ import annotations

from pathlib import Path

import pytest
from tactile_loc_cli.scaffold.examples import make_examples
from tactile_loc_cli.scaffold.naming import Naming
from tactile_loc_cli.scaffold.package import render

from tactile_loc.slots.registry import KINDS

PAGE = Path(__file__).parents[1] / "docs" / "plugin-examples.md"


def test_the_page_is_up_to_date():
    assert PAGE.read_text() == make_examples(), "run python -m tactile_loc_cli.scaffold.examples"


@pytest.mark.parametrize("slot", KINDS)
def test_the_page_shows_the_generated_module_of_every_slot(slot):
    naming = Naming(slot, f"my-{slot}")
    files = render(naming)
    assert files[f"{naming.package}/{naming.module}.py"] in PAGE.read_text()
