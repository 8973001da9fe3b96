"""The soak reports growth, open files and changed answers; and a short run of it."""

from __future__ import annotations

import itertools
import os
import sys

import pytest
import soak
from soak import Held, Soaked

WARM = Held(1_000_000, 10)


@pytest.mark.parametrize(
    ("end", "changed", "good"),
    [
        (Held(1_019_000, 10), 0, True),
        (Held(1_021_000, 10), 0, False),
        (Held(1_000_000, 11), 0, False),
        (WARM, 1, False),
    ],
)
def test_what_grows_or_changes_is_not_good(end, changed, good):
    assert Soaked("work", 100, WARM, end, changed, 1.0).is_good is good


def test_memory_that_is_kept_and_files_that_stay_open_are_seen(tmp_path, monkeypatch):
    kept: list[object] = []
    monkeypatch.setattr(Held, "now", lambda: Held(10**6 + 1000 * len(kept), len(os.listdir("/proc/self/fd"))))

    def leak():
        for number in itertools.count():
            kept.append((tmp_path / f"{number}").open("w"))
            yield number % 2 == 1

    found = soak.soak("leaks", 60, leak())
    assert found.growth > soak.MOST_GROWTH
    assert found.end.files - found.warm.files == 54, "of the last nine tenths"
    assert found.changed == 30


def test_locating_and_tracking_change_nothing(monkeypatch, capsys):
    monkeypatch.setattr(soak, "SLIDE", 30)
    monkeypatch.setattr(sys, "argv", ["soak.py", "--localisations", "6", "--touches", "2", "--seconds", "0.1"])
    soak.main()
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0] for row in rows] == ["| localisations", "| frames tracked"]
    assert all(row[-1].startswith("0 ") for row in rows), "answers that changed"
