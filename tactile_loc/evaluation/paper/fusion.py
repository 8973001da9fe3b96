"""The paper's protocol for several simulated touches of one object: the error by number of contacts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Floats, Ints, Poses, invert
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.pose_errors import compute_adds
from tactile_loc.core.poses.posterior import PosePosterior, require_pose_left
from tactile_loc.core.runtime.compiled import use_one_blas_thread
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.metrics import PoseJudge
from tactile_loc.evaluation.protocol import describe_located, label_run, measure_in_shards
from tactile_loc.evaluation.simulated_touches import SimulatedTouches, require_true_pose
from tactile_loc.evaluation.table import MOST_FUSED, ExampleTable, name_errors, sort_numbers
from tactile_loc.locate.localizer import Localizer
from tactile_loc.slots.fuser import Fuser
from tactile_loc.slots.registry import registry
from tactile_loc.store.keys import StageKey

FUSION_VERSION = 3  # increase if the same localizer gets other results
FUSION_LINES = ("best-1", "reg-1", "kinematic", "random")
FUSED_LINES = FUSION_LINES[:3]
SHARD = 10  # examples located and saved at once
ARRAYS = ("errors_m", "alone", "refused")


def evaluate_fusion(
    localizer: Localizer, contacts: Sequence[int], count: int, touches: SimulatedTouches
) -> ExampleTable:
    """Locate `count` examples from each number of `contacts`, with the localizer's fuser and the kinematic fuser.

    The table has a row for each example and number of contacts, with the ADD of FUSION_LINES, symmetric poses equal.
    The line reg-1 is best-1, refined to all contacts. The column "LINE alone" marks examples in which a line of
    FUSED_LINES found no pose common to all contacts, and used only the first contact. `refused` is the number of
    presses of an example that made no touch; they do not count.

    Example e has the touches MOST_FUSED e, MOST_FUSED e + 1, ... of `touches`. So an example with more contacts has the
    same touches and further ones. The object is at rest, and the touches' true poses give the sensor poses.

    The result is kept in the localizer's store, in shards of SHARD examples. An interrupted evaluation resumes. Raises
    ConfigError unless all numbers of contacts are from 1 to MOST_FUSED, and TactileLocError if a touch cannot be
    located.
    """
    numbers = sort_numbers(contacts, "contacts")
    key, examples = make_fusion_key(localizer, numbers, count, touches), _FusedExamples(localizer, numbers, touches)
    errors_m, alone, refused = measure_in_shards(localizer.store, key, ARRAYS, count, SHARD, examples.locate).values()
    columns = {
        **name_errors(errors_m.reshape(-1, len(FUSION_LINES))[..., None], FUSION_LINES, ("add",)),
        **{f"{line} alone": alone[..., k].ravel() for k, line in enumerate(FUSED_LINES)},
    }
    return ExampleTable.make(
        columns,
        **label_run(localizer, touches),
        example=np.repeat(np.arange(count), len(numbers)),
        touches=np.tile(numbers, count),
        refused=np.repeat(refused, len(numbers)),
    )


def make_fusion_key(localizer: Localizer, contacts: Sequence[int], count: int, touches: SimulatedTouches) -> StageKey:
    """Return the store key of an evaluation, made from all inputs of its errors."""
    own: dict[str, Any] = {
        "kinematic": _make_kinematic().describe(),
        "contacts": list(contacts),
        "refiner": localizer.refinement.refiner.describe(),
    }
    return StageKey("contact-evaluation", FUSION_VERSION, {**describe_located(localizer, touches, count), **own})


@dataclass(frozen=True, eq=False)
class _FusedExamples:
    """Locates examples from touches whose true poses are known."""

    localizer: Localizer
    contacts: tuple[int, ...]
    source: SimulatedTouches

    def locate(self, numbers: range) -> list[NDArray[Any]]:
        """Return the ARRAYS of some examples."""
        name = self.localizer.object.name
        task = f"locating {name} by contacts, examples {numbers[0] + 1} to {numbers[-1] + 1}"
        with self.localizer.progress.task(task, len(numbers)) as advance:
            posteriors, touches, refused = self._locate_touches(numbers)
            rows = []
            for example in zip(numbers, posteriors, touches, strict=True):
                rows.append(self._locate_example(*example))
                advance(1)
        return [*(np.stack(column) for column in zip(*rows, strict=True)), refused]

    def _locate_touches(self, numbers: range) -> tuple[list[list[PosePosterior]], list[list[Touch]], Ints]:
        """Return each example's posteriors and touches, and the refused presses (E,)."""
        most = self.contacts[-1]
        drawn = [self.source.draw_counted(self.localizer, MOST_FUSED * e + k) for e in numbers for k in range(most)]
        touches = [touch for touch, _ in drawn]
        refused = np.array([count for _, count in drawn]).reshape(len(numbers), most).sum(axis=1)
        found: dict[int, PosePosterior] = {}
        for i in sorted(range(len(touches)), key=lambda i: touches[i].press_depth_m):  # one bank after the other
            found[i] = self.localizer.posterior_alone(touches[i])
        starts = range(0, len(touches), most)
        return [[found[i + k] for k in range(most)] for i in starts], [touches[i : i + most] for i in starts], refused

    def _locate_example(
        self, number: int, posteriors: Sequence[PosePosterior], touches: Sequence[Touch]
    ) -> tuple[Floats, Bools]:
        """Return one example's errors (C, L), metres, and a mask (C, 3) of the lines that found no common pose."""
        grid, T_base_sensor = posteriors[0].grid, invert(np.stack([require_true_pose(touch) for touch in touches]))
        resting = [replace(touch, T_base_sensor=T) for touch, T in zip(touches, T_base_sensor, strict=True)]
        rng = np.random.default_rng(self.source.seed_touch(MOST_FUSED * number, 1))
        guesses = rng.integers(len(grid), size=MOST_FUSED)
        lots = rng.random((MOST_FUSED, len(self._fusers)))
        poses, alone = [], []
        for n in self.contacts:
            fused = [_fuse(fuser, posteriors[:n], T_base_sensor[:n]) for fuser in self._fusers]
            best, kinematic = (_draw(posterior, lot) for (posterior, _), lot in zip(fused, lots[n - 1], strict=True))
            (posterior, without), (_, without_kinematic) = fused
            refined = self._refine(resting[: 1 if without else n], posterior, best)
            T, guess = grid.T_sensor_object, guesses[n - 1]
            poses += [T[best], refined, T[kinematic], T[guess]]
            alone.append([without, without, without_kinematic])
        truth = require_true_pose(touches[0])
        errors = compute_adds(self.localizer.object, self._points_m, np.stack(poses), truth)
        return errors.reshape(len(self.contacts), len(FUSION_LINES)), np.array(alone)

    @use_one_blas_thread()
    def _refine(self, touches: Sequence[Touch], posterior: PosePosterior, index: int) -> Floats:
        """Return a grid pose (4, 4), metres, refined to touches of the object at rest."""
        candidate = Candidate(posterior.grid.T_sensor_object[index], index, float(posterior.log_p[index]))
        (refined,) = self.localizer.refinement.refine(self.localizer.make_views(touches), [candidate])
        return refined.T_sensor_object

    @cached_property
    def _fusers(self) -> tuple[Fuser, Fuser]:
        return self.localizer.fuser, _make_kinematic()

    @cached_property
    def _points_m(self) -> Floats:
        return PoseJudge(self.localizer.object).points_m


def _make_kinematic() -> Fuser:
    fuser: Fuser = registry().create("fuser", "kinematic", {})
    return fuser


def _fuse(fuser: Fuser, posteriors: Sequence[PosePosterior], T_base_sensor: Poses) -> tuple[PosePosterior, bool]:
    """Fuse touches of sensors at (M, 4, 4), metres; return the posterior and False.

    If no pose is common to all touches, return the posterior of the first touch and True.
    """
    fused = fuser.fuse(posteriors, list(T_base_sensor))
    if isinstance(fused, PosePosterior):
        return fused, False
    return require_pose_left(fuser.fuse(posteriors[:1], [T_base_sensor[0]])), True


def _draw(posterior: PosePosterior, lot: float) -> int:
    """Return the index of the most probable pose; `lot`, 0 to below 1, decides between equally probable poses."""
    most = np.flatnonzero(posterior.log_p == posterior.log_p.max())
    return int(most[int(lot * len(most))])
