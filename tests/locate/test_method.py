"""The note on the tasks that the joint registration does instead of the chosen refiner."""

from __future__ import annotations

from typing import Any

import pytest
from message_helpers import missing

from tactile_loc.locate.method import Refinement
from tactile_loc.slots.registry import registry


def explain(refiner: str, searched: bool, together: Any = "joint") -> str:
    registration: Any = None  # the note does not depend on it
    chosen = registry().create("refiner", refiner)
    return Refinement(chosen, refiner, registration, together).describe_other_tasks(searched)


@pytest.mark.parametrize(
    ("refiner", "searched", "together", "named"),
    [
        ("icp", True, "joint", ["covariances", "search", "several touches"]),
        ("icp", False, "joint", ["covariances", "several touches"]),
        ("icp", False, "each", ["covariances"]),
        ("none", True, "joint", ["search"]),
        ("none", False, "joint", []),
        ("joint", True, "joint", []),
    ],
)
def test_the_note_names_only_the_tasks_of_the_joint_registration(refiner, searched, together, named):
    said = explain(refiner, searched, together)
    tasks = ["covariances", "search", "several touches"]
    assert [task for task in tasks if task in said] == named
    assert bool(said) == bool(named)
    assert not named or not missing(said, refiner, "joint registration")
