"""The simulated robot: it moves the gripper, grasps, clamps the part, and reports forces and true poses."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray
from scene import ARM_DAMPING, ARM_STIFFNESS, AXES, OPEN_M, TIMESTEP_S
from scipy.spatial.transform import Rotation, Slerp

from tactile_loc.plugin.helpers import make_transform

Pose = NDArray[np.float64]

TICK_STEPS = 5  # steps of the engine between two targets, and between two readings of the force
GRIP_N, OPENING_N = 20.0, -2.0  # force of each finger
SOFT = 0.02  # share of the arm's stiffness while the gripper closes on a clamped part
SPEED_M_S, TURN_RAD_S = 0.15, 1.5
CLAMPS = {"soft": (0.05, 1.0), "hard": (0.002, 1.0)}  # time constant and damping ratio of the clamp


class Robot:
    """Moves the gripper of a scene. `watch` is called after each tick, for instance by a camera."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.watch: Callable[[Robot], None] | None = None
        self.peak_force_n = 0.0
        self._hole = model.geom_bodyid == model.body("plate").id
        self._weld = model.equality("clamp").id
        self._target = np.eye(4)

    @property
    def time_s(self) -> float:
        """The simulated time, seconds."""
        return float(self.data.time)

    @property
    def T_world_gripper(self) -> Pose:  # noqa: N802
        """The gripper's pose (4, 4), metres, from the encoders."""
        return self._read("gripper")

    @property
    def T_world_part(self) -> Pose:  # noqa: N802
        """The part's true pose (4, 4), metres, which no method but the first may use."""
        return self._read("part")

    @property
    def opening_m(self) -> tuple[float, float]:
        """The distance of each gel from the gripper's middle, metres: left, right."""
        return tuple(OPEN_M - float(self.data.joint(name).qpos[0]) for name in ("left", "right"))

    @property
    def stiffness_z(self) -> float:
        """The arm's stiffness along z, N/m."""
        return ARM_STIFFNESS[2]

    def save(self) -> NDArray[np.float64]:
        """Return the state, for `restore`."""
        state = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return state

    def restore(self, state: NDArray[np.float64]) -> None:
        """Continue from a saved state."""
        mujoco.mj_setState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(self.model, self.data)
        self._target, self.peak_force_n = self.T_world_gripper, 0.0

    def place(self, T_world_gripper: Pose, T_world_part: Pose) -> None:
        """Put the open gripper and the part at their poses (4, 4), metres."""
        self.data.qpos[self.model.joint("x").qposadr[0] :][:6] = find_joints(T_world_gripper)
        start = self.model.jnt_qposadr[self.model.body_jntadr[self.model.body("part").id]]
        self.data.qpos[start : start + 7] = _to_qpos(T_world_part)
        self._target = T_world_gripper
        self.data.ctrl[:6] = find_joints(T_world_gripper)
        mujoco.mj_forward(self.model, self.data)

    def clamp(self, kind: str = "hard") -> None:
        """Clamp the part where it is."""
        self.model.eq_solref[self._weld] = CLAMPS[kind]
        pose = _to_qpos(self.T_world_part)
        self.data.mocap_pos[0], self.data.mocap_quat[0] = pose[:3], pose[3:]
        self.data.eq_active[self._weld] = 1

    def release(self) -> None:
        """Open the clamp."""
        self.data.eq_active[self._weld] = 0

    def grasp(self, soft_arm: bool = False) -> None:
        """Close the fingers. With a soft arm, the gripper aligns itself with a clamped part."""
        if soft_arm:
            self._set_stiffness(SOFT)
        self.data.ctrl[6:] = GRIP_N
        self.wait(0.5)
        if soft_arm:
            self._target = self.T_world_gripper
            self.data.ctrl[:6] = find_joints(self._target)
            self._set_stiffness(1.0)
            self.wait(0.1)

    def open(self) -> None:
        """Open the fingers."""
        self.data.ctrl[6:] = OPENING_N
        self.wait(0.3)

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        for _ in range(round(duration_s / (TICK_STEPS * TIMESTEP_S))):
            self._tick()

    def move(
        self, T_world_gripper: Pose, speed_m_s: float = SPEED_M_S, stop_n: float = np.inf,
        until: Callable[[Robot], bool] | None = None,
    ) -> bool:  # fmt: skip
        """Move the gripper's target along a line to a pose (4, 4), metres, and return whether it arrived.

        The motion stops where the force between part and plate is above `stop_n`, or where `until` returns True.
        """
        start, end = self._target, T_world_gripper
        turn = Slerp([0, 1], Rotation.from_matrix([start[:3, :3], end[:3, :3]]))
        duration_s = max(
            np.linalg.norm(end[:3, 3] - start[:3, 3]) / speed_m_s,
            Rotation.from_matrix(start[:3, :3].T @ end[:3, :3]).magnitude() / TURN_RAD_S,
        )
        ticks = max(1, round(duration_s / (TICK_STEPS * TIMESTEP_S)))
        share = np.arange(1, ticks + 1)[:, None] / ticks
        positions_m = (1 - share) * start[:3, 3] + share * end[:3, 3]
        rotations = turn(share[:, 0])
        angles_rad = rotations.as_euler("ZYX")
        for k in range(ticks):
            self._target = make_transform(rotations[k].as_matrix(), positions_m[k])
            self.data.ctrl[:6] = [*positions_m[k], *angles_rad[k]]
            if self._tick() > stop_n or (until is not None and until(self)):
                return False
        return True

    def measure_force_n(self) -> float:
        """Return the size of the force between part and plate, newtons."""
        total, force = np.zeros(3), np.zeros(6)
        ours = self._hole[self.data.contact.geom]  # (contacts, 2)
        for k in np.flatnonzero(ours.any(axis=1)):
            mujoco.mj_contactForce(self.model, self.data, k, force)
            push = self.data.contact.frame[k].reshape(3, 3).T @ force[:3]
            total += push if ours[k, 0] else -push
        return float(np.linalg.norm(total))

    def _tick(self) -> float:
        mujoco.mj_step(self.model, self.data, TICK_STEPS)
        force_n = self.measure_force_n()
        self.peak_force_n = max(self.peak_force_n, force_n)
        if self.watch is not None:
            self.watch(self)
        return force_n

    def _set_stiffness(self, share: float) -> None:
        for k in range(len(AXES)):
            self.model.actuator_gainprm[k, 0] = share * ARM_STIFFNESS[k]
            self.model.actuator_biasprm[k, 1:3] = -share * ARM_STIFFNESS[k], -np.sqrt(share) * ARM_DAMPING[k]

    def _read(self, body: str) -> Pose:
        found = self.data.body(body)
        return make_transform(found.xmat.reshape(3, 3).copy(), found.xpos.copy())


def find_joints(T_world_gripper: Pose) -> NDArray[np.float64]:
    """Return the arm's joints (6,), metres and radians, for a gripper's pose (4, 4)."""
    return np.concatenate([T_world_gripper[:3, 3], Rotation.from_matrix(T_world_gripper[:3, :3]).as_euler("ZYX")])


def _to_qpos(T: Pose) -> NDArray[np.float64]:
    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)])
