from __future__ import annotations

import re

import pytest
from message_helpers import missing, naming


@pytest.mark.parametrize("text", ["plan.toml: 3.5 mm of 40", "of 40, 3.5 mm are\nin plan.toml."])
def test_all_values_are_found_in_any_order(text):
    assert re.search(naming("plan.toml", "3.5 mm", 40), text)
    assert not missing(text, "plan.toml", "3.5 mm", 40)


@pytest.mark.parametrize("value", ["planXtoml", "5 mm", 4, 0, "sweep.toml"])
def test_values_absent_from_the_text_are_missing(value):
    text = "plan.toml: 3.5 mm of 40"
    assert not re.search(naming("plan.toml", value), text)
    assert missing(text, "plan.toml", value) == [str(value)]
