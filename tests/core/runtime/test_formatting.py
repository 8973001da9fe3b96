"""Formatting of SI values and names for people."""

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


@pytest.mark.parametrize(
    ("write", "texts"),
    [
        (format_mm, {2.1e-5: "0.021", 1.94e-3: "1.94", 4.82e-2: "48.2"}),
        (format_millimetres, {1.9e-5: "0.02 mm", 0.00187: "1.9 mm", 0.0478: "48 mm"}),
        (format_percent, {1.0: "100 %", 0.997: "99.7 %", 0.99: "99 %", 0.612: "61 %", 0.028: "2.8 %"}),
        (format_percent, {0.0004: "< 0.1 %", 0.0: "< 0.1 %"}),
        (format_bytes, {0: "0 B", 999: "999 B", 1000: "1 kB", 12_345_678: "12.3 MB", 4_560_000_000: "4.56 GB"}),
        (format_duration, {0.0123: "12.3 ms", 0.9999: "999.9 ms", 4.54: "4.5 s"}),
    ],
)
def test_values_are_written_with_few_digits_and_a_unit(write, texts):
    assert {value: write(value) for value in texts} == texts


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
