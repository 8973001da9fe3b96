"""A configuration as TOML."""

from __future__ import annotations

import tomllib

import pytest

from tactile_loc.io.config import RunConfig
from tactile_loc.io.toml import toml_text
from tactile_loc.locate.result_json import resolved


def test_it_is_read_as_the_same_configuration():
    config = RunConfig.from_dict(
        {"object": {"path": 'a "b"\\é.stl'}, "grid": {"name": "face", "tilt_deg": 3.5}, "top": 4, "seed": 9}
    )
    text = toml_text(resolved(config))
    again = RunConfig.from_dict(tomllib.loads(text))
    assert resolved(again) == resolved(config)


@pytest.mark.parametrize(
    ("value", "text"),
    [(True, "true"), (1.5, "1.5"), ([1, [2, "a"]], '[1, [2, "a"]]'), ({"a": 1, "b c": None}, "{ a = 1 }")],
)
def test_values_are_toml(value, text):
    assert toml_text({"key": value} if not isinstance(value, dict) else {"s": {"key": value}}).endswith(
        f"key = {text}\n"
    )


def test_what_is_not_set_is_left_out():
    assert toml_text({"touch": {"path": None, "noise": "none"}}) == '[touch]\nnoise = "none"\n'
