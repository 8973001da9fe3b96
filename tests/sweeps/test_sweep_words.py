"""What people write on the command line."""

from __future__ import annotations

import pytest

from tactile_loc.sweeps.words import merge_options, read_options, split_all, split_values


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("none,icp", ["none", "icp"]),
        (" none , icp ,", ["none", "icp"]),
        ("one", ["one"]),
        ("[1,2],[3]", ["[1,2]", "[3]"]),
        ("'a,b',c", ["'a,b'", "c"]),
        ('{x="}",y=2},3', ['{x="}",y=2}', "3"]),
        ("", []),
    ],
)
def test_values_are_parted_at_commas_but_not_within_brackets_or_quotes(text, parts):
    assert split_values(text) == parts


def test_a_flag_may_be_repeated():
    assert split_all(["none,icp", "render"]) == ["none", "icp", "render"]


def test_words_of_one_option_add_up():
    words = ["grid.spacing_mm=3,4.5", "encoder.signal=depth", "grid.spacing_mm=6", "grid.face='auto'"]
    assert read_options(words, "here") == {
        "grid": {"spacing_mm": [3, 4.5, 6], "face": ["auto"]},
        "encoder": {"signal": ["depth"]},
    }


def test_options_of_the_command_line_replace_the_files():
    file = read_options({"grid": {"spacing_mm": [3, 4], "face": "auto"}}, "file")
    assert merge_options(file, read_options(["grid.spacing_mm=9"], "line")) == {
        "grid": {"spacing_mm": [9], "face": ["auto"]}
    }
