"""Shared parts of the tables of evaluations."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.evaluation.tabular import Statistics, bracket_shares, format_csv, format_markdown, list_columns


def test_statistics_of_known_values():
    s = Statistics.of(np.arange(1.0, 12.0))
    assert (s.mean, s.median, s.q25, s.q75, s.p90) == (6, 6, 3.5, 8.5, 10)
    assert s.std == pytest.approx(np.sqrt(10))


def test_columns_hold_mm_and_normalised_values():
    found = list_columns(Statistics(1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3), Statistics(0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    assert (found["mean_mm"], found["p90_mm"], found["median_normalised"]) == ("1", "6", "0.2")
    assert len(found) == 12


def test_rows_are_written_as_markdown_and_csv():
    heads = ["n", "p", "q"]
    rows = bracket_shares([heads, ["a", "1", "2"], ["b", "3", "4"]], [heads, ["a", "x", "y"], ["b", "z", "w"]], names=1)
    assert rows == [heads, ["a", "1 (x)", "2 (y)"], ["b", "3 (z)", "4 (w)"]]
    assert format_markdown(rows[:2]) == "| n | p | q |\n| --- | --- | --- |\n| a | 1 (x) | 2 (y) |\n"
    assert format_csv([{"n": "a", "p": 1}, {"n": "b", "p": 2}]) == "n,p\na,1\nb,2\n"
