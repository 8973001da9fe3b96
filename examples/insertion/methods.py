"""The five methods that are compared. Each starts from the same grasp, and ends with the part inserted or not."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from controller import Action, Placement, choose_placement, decide, find_chance, list_placements
from insertion import insert, search_blindly
from numpy.typing import NDArray
from robot import Robot
from shapes import Part
from touching import Gels

from tactile_loc import GaussianPrior, Localization, Touch, localize_together
from tactile_loc.plugin import TouchError
from tactile_loc.plugin.helpers import invert

Pose = NDArray[np.float64]

PRIOR_STD_M, PRIOR_STD_RAD = 5e-3, np.radians(10)  # of the nominal pose
LISTED = 20  # of the hypotheses; the search refines as many in any case


@dataclass(frozen=True, eq=False)
class Started:
    """Where the part was in the gripper (4, 4), metres, when the insertion started: believed, and in truth."""

    T_believed: Pose
    T_true: Pose


@dataclass(eq=False)
class Bench:
    """Everything that a method may use, and its `log` of located poses. Only `insert_known` may use the true pose.

    `started` is None as long as the insertion has not started.
    """

    robot: Robot
    part: Part
    gels: Gels
    rng: np.random.Generator
    log: list[Localization] = field(default_factory=list)
    touches: list[Touch] = field(default_factory=list)
    placements: list[str] = field(default_factory=lambda: ["nominal"])
    started: Started | None = None

    def insert(self, T_gripper_part: Pose, how: Callable[[Robot, Pose, Part], None] = insert) -> None:
        """Insert the part, believed to be at `T_gripper_part` (4, 4), metres."""
        self.started = Started(T_gripper_part, invert(self.robot.T_world_gripper) @ self.robot.T_world_part)
        how(self.robot, T_gripper_part, self.part)

    def touch(self) -> None:
        """Add the touches that the gels measure now. Raises TouchError if no gel has felt the part so far."""
        self.touches += self.gels.touch(self.robot, self.rng)
        if not self.touches:
            raise TouchError("neither gel feels the part; grasp it nearer to its middle")

    def regrasp(self, placement: Placement) -> None:
        """Clamp the part, and grasp it at another placement, with a soft arm."""
        self.robot.clamp()
        self.robot.open()
        self.robot.move(placement.T_world_gripper)
        self.robot.grasp(soft_arm=True)
        self.placements.append(placement.name)

    def locate(self, prior: GaussianPrior) -> Localization:
        """Locate the part from all touches. The prior is over poses in the world."""
        localizer, first = self.gels.localizer, self.touches[0]
        observations = [(localizer, touch) for touch in self.touches]
        found = localize_together(observations, prior.view_from(first.T_base_sensor), LISTED)
        self.log.append(found)
        return found

    def expect_nominal(self) -> GaussianPrior:
        """Return the prior that the grasp is roughly nominal, in the world."""
        symmetry = self.gels.localizer.object.symmetry
        return GaussianPrior(self.robot.T_world_gripper, PRIOR_STD_M, PRIOR_STD_RAD, symmetry)


def insert_known(bench: Bench) -> None:
    """(a) The part's pose in the fingers is known exactly."""
    bench.insert(invert(bench.robot.T_world_gripper) @ bench.robot.T_world_part)


def insert_after_first_touch(bench: Bench) -> None:
    """(b) Use the first pose that explains the first touches, whatever the verdict."""
    bench.touch()
    found = bench.locate(bench.expect_nominal())
    bench.insert(invert(bench.robot.T_world_gripper) @ found.best.T_base_object)


def insert_when_certain(bench: Bench) -> None:
    """(c) Touch until the tip is known well enough; then insert."""
    robot, prior = bench.robot, bench.expect_nominal()
    bench.touch()
    while True:
        found = bench.locate(prior)
        action = decide(found.verdict, find_chance(found, bench.part), len(bench.placements))
        if action is not Action.TOUCH:
            break
        placements = list_placements(found.best.T_base_object, bench.part)
        bench.regrasp(choose_placement(found, placements, bench.placements))
        bench.touch()
    if action is Action.INSERT:
        T_gripper_part = invert(robot.T_world_gripper) @ found.best.T_base_object
        robot.release()
        bench.insert(T_gripper_part)


def insert_by_search(bench: Bench) -> None:
    """(d) Search the hole blindly along a spiral, from the nominal pose."""
    bench.insert(np.eye(4), search_blindly)


def insert_nominal(bench: Bench) -> None:
    """(e) Trust the nominal pose."""
    bench.insert(np.eye(4))


METHODS: dict[str, Callable[[Bench], None]] = {
    "known": insert_known,
    "first touch": insert_after_first_touch,
    "verdict": insert_when_certain,
    "spiral": insert_by_search,
    "nominal": insert_nominal,
}
