"""docs/plugins.md lists the refused combinations."""

from __future__ import annotations

import combinations as page
import pytest

from tactile_loc.slots.compatibility import INCOMPATIBILITIES, Declared


def test_the_table_is_up_to_date():
    shown = page.TABLE.search(page.PAGE.read_text(encoding="utf-8"))
    assert shown, "docs/plugins.md has no table of combinations"
    assert shown[0] == page.table(), "run python docs/combinations.py"


def test_each_rule_is_a_row():
    rows = page.table().splitlines()[2:]
    assert len(rows) == len(INCOMPATIBILITIES) > 0
    for row, rule in zip(rows, INCOMPATIBILITIES, strict=True):
        assert rule.reason in row
        assert rule.advice in row


@pytest.mark.parametrize(
    ("declared", "names"),
    [
        (Declared("grid", "places", True), ["whole"]),
        (Declared("matcher", "top_k_only", True), ["faiss"]),
        (Declared("matcher", "weights", False), []),
        (Declared("fuser", "contact_only", False), ["product"]),
    ],
)
def test_built_in_components_are_found_by_their_declaration(declared, names):
    assert list(page._declaring(declared)) == names
