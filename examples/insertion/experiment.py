"""One trial: the grasp, then each method from this grasp, and the record of each."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from insertion import is_inserted, measure_depth_m
from methods import METHODS, Bench, Started
from numpy.typing import NDArray
from robot import Robot
from scene import build_model
from shapes import PARTS, ROUND, TIP_Z_M, Part
from touching import Gels, make_localizer
from trials import Trial

from tactile_loc import StageStore, TactileLocError
from tactile_loc.plugin.helpers import invert, make_translation

Pose = NDArray[np.float64]

HOME = make_translation([0.12, 0.0, 0.1])  # where the gripper takes the part
SETTLING_S = 0.3


@dataclass(frozen=True)
class Record:
    """The outcome of one method in one trial.

    `touches` counts images of single gels. `errors` are those of `measure_errors`. `slip_mm` is how far the part's tip
    moved in the fingers during the insertion.
    """

    trial: int
    part: str
    clearance_mm: float
    seed: int
    method: str
    success: bool
    outcome: str
    time_s: float
    touches: int
    placements: list[str]
    peak_force_n: float
    depth_mm: float
    errors: dict[str, float]
    slip_mm: float
    verdicts: list[str]


class Experiment:
    """Runs trials. Meshes go to `folder`; the localizers share a store."""

    def __init__(self, folder: Path, store: StageStore | None = None) -> None:
        self.folder, self.store = folder, store
        self._gels: dict[str, Gels] = {}

    def run(self, trial: Trial, methods: Sequence[str] = tuple(METHODS)) -> list[Record]:
        """Run methods from the grasp of a trial, and return their records."""
        robot, start = self.start(trial)
        return [self.run_method(name, trial, robot, start) for name in methods]

    def run_method(self, name: str, trial: Trial, robot: Robot, start: NDArray[np.float64]) -> Record:
        """Run one method from the state `start` after the grasp, and return its record."""
        robot.restore(start)
        bench = Bench(robot, PARTS[trial.part](), self.find_gels(trial.part), np.random.default_rng(trial.seed))
        begun_s, error = robot.time_s, ""
        try:
            METHODS[name](bench)
        except TactileLocError as raised:
            error = str(raised)
        return make_record(name, trial, bench, robot.time_s - begun_s, error)

    def start(self, trial: Trial) -> tuple[Robot, NDArray[np.float64]]:
        """Return the robot that has grasped the part, and its state."""
        part = PARTS[trial.part]()
        robot = Robot(build_model(part, 1e-3 * trial.clearance_mm))
        robot.place(HOME, HOME @ trial.draw_error(np.random.default_rng(trial.seed)))
        robot.clamp("soft")
        robot.grasp()
        robot.release()
        robot.wait(SETTLING_S)
        return robot, robot.save()

    def find_gels(self, name: str) -> Gels:
        """Return the gels for a part; they are made once."""
        if name not in self._gels:
            self._gels[name] = Gels.of(make_localizer(PARTS[name](), self.folder, self.store))
        return self._gels[name]


def make_record(name: str, trial: Trial, bench: Bench, time_s: float, error: str) -> Record:
    """Return the record of a finished method; `error` is the message that ended it, or ""."""
    robot, part, started = bench.robot, bench.part, bench.started
    success = started is not None and not error and is_inserted(robot, part)
    outcome = error or ("inserted" if success else "stopped" if started is None else "not inserted")
    slip_m = 0.0
    if started is not None:
        now = invert(robot.T_world_gripper) @ robot.T_world_part
        slip_m = float(np.linalg.norm((now - started.T_true) @ [0, 0, TIP_Z_M, 1]))
    return Record(
        trial.number, trial.part, trial.clearance_mm, trial.seed, name, success, outcome, round(time_s, 3),
        len(bench.touches), bench.placements, round(robot.peak_force_n, 2), round(1e3 * measure_depth_m(robot), 3),
        measure_errors(started, part), round(1e3 * slip_m, 3), [found.verdict.value for found in bench.log],
    )  # fmt: skip


def measure_errors(started: Started | None, part: Part) -> dict[str, float]:
    """Return the errors of the pose with which the insertion started; empty if it did not start.

    They are those of the tip across the long axis, along it, of the axis, and about it up to the shank's symmetry.
    """
    if started is None:
        return {}
    T = invert(started.T_believed) @ started.T_true  # of the part, in its believed frame
    shift_m = T[:3, :3] @ [0, 0, TIP_Z_M] + T[:3, 3] - [0, 0, TIP_Z_M]
    period_deg = 360 / part.fits
    yaw_deg = np.degrees(np.arctan2(T[1, 0], T[0, 0])) if part.fits < ROUND else 0.0
    values = {
        "tip_mm": 1e3 * np.hypot(*shift_m[:2]), "z_mm": 1e3 * shift_m[2],
        "tilt_deg": np.degrees(np.arccos(np.clip(T[2, 2], -1, 1))),
        "yaw_deg": (yaw_deg + period_deg / 2) % period_deg - period_deg / 2,
    }  # fmt: skip
    return {key: round(float(value), 3) for key, value in values.items()}
