"""What refines poses: the note on the tasks of the joint registration, and the record of a result."""

from typing import Any

import pytest
from message_helpers import missing

from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.method import JOINT, Refinement
from tactile_loc.locate.result.hypothesis import RefinedBy
from tactile_loc.slots.registry import registry


def explain(refiner: str, searched: bool) -> str:
    registration: Any = None  # the note does not depend on it
    chosen = registry().create("refiner", refiner)
    return Refinement(chosen, refiner, registration).describe_other_tasks(searched)


@pytest.mark.parametrize(
    ("refiner", "searched", "named"),
    [
        ("icp", True, ["covariances", "search"]),
        ("icp", False, ["covariances"]),
        ("none", True, ["search"]),
        ("none", False, []),
        ("joint", True, []),
    ],
)
def test_the_note_names_only_the_tasks_of_the_joint_registration(refiner, searched, named):
    said = explain(refiner, searched)
    tasks = ["covariances", "search"]
    assert [task for task in tasks if task in said] == named
    assert bool(said) == bool(named)
    assert not named or not missing(said, refiner, "joint registration")


@pytest.mark.parametrize(
    ("refiner", "count", "searched", "stated"),
    [
        ("icp", 1, True, RefinedBy(JOINT, "icp", None, JOINT)),
        ("icp", 3, False, RefinedBy(None, "icp", "alone", JOINT)),
        ("joint", 3, True, RefinedBy(JOINT, "joint", "together", "joint")),
        ("none", 3, True, RefinedBy(JOINT, None, None, None)),
    ],
)
def test_the_record_states_what_refined_the_poses(localizer, refiner, count, searched, stated):
    touches = localizer.simulate(1) * count
    registration: Any = None
    refinement = Refinement(registry().create("refiner", refiner), refiner, registration)
    assert refinement.describe(touches, searched) == stated


def test_the_joint_registration_refines_poses_to_masks(localizer):
    (touch,) = localizer.simulate(1)
    mask = Touch.from_mask(touch.contact_shape.contact, sensor=touch.geometry)
    registration: Any = None
    refinement = Refinement(registry().create("refiner", "icp"), "icp", registration)
    assert refinement.describe([mask, touch], False) == RefinedBy(None, JOINT, "together", JOINT)
