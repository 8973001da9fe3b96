"""Formatting of SI values and names for people."""

from __future__ import annotations

import os

import pytest

from tactile_loc.core.runtime.formatting import (
    format_bytes,
    format_duration,
    format_millimetres,
    format_mm,
    format_percent,
    is_unicode,
    show_name,
)


def test_lengths_have_three_digits():
    assert [format_mm(v) for v in (2.1e-5, 1.94e-3, 4.82e-2)] == ["0.021", "1.94", "48.2"]


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (1.0, "100 %"),
        (0.997, "99.7 %"),
        (0.99, "99 %"),
        (0.612, "61 %"),
        (0.028, "2.8 %"),
        (0.0004, "< 0.1 %"),
        (0.0, "< 0.1 %"),
    ],
)
def test_shares_are_written_as_percentages(share, text):
    assert format_percent(share) == text


@pytest.mark.parametrize(("length", "text"), [(1.9e-5, "0.02 mm"), (0.00187, "1.9 mm"), (0.0478, "48 mm")])
def test_lengths_are_written_in_millimetres(length, text):
    assert format_millimetres(length) == text


def test_sizes_are_written_in_bytes():
    assert [format_bytes(n) for n in (0, 999, 1000, 12_345_678, 4_560_000_000)] == [
        "0 B",
        "999 B",
        "1 kB",
        "12.3 MB",
        "4.56 GB",
    ]


def test_durations_are_written_with_a_unit():
    assert [format_duration(s) for s in (0.0123, 0.9999, 4.54)] == ["12.3 ms", "999.9 ms", "4.5 s"]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("Gehäuse 日本.obj", "Gehäuse 日本.obj"),
        (os.fsdecode(b"Geh\xe4use.obj"), r"Geh\xe4use.obj"),
        ("a\nb\x1b[31m\u202e", r"a\nb\x1b[31m\u202e"),
        ("\ud800", r"\ud800"),
    ],
)
def test_names_become_printable_text_in_one_line(name, text):
    assert show_name(name) == text
    assert is_unicode(show_name(name))
    assert is_unicode(name) == ("\\" not in text or "\n" in name)
