"""The protocol of sweeps and of the paper for one simulated touch: errors of estimates, and the least of the grid."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.pose_errors import compute_adds
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.metrics import POSTERIOR_METRICS, PoseJudge, measure_posterior
from tactile_loc.evaluation.simulated_touches import SimulatedTouches, require_true_pose
from tactile_loc.evaluation.table import ExampleTable, name_errors
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

Arrays = Sequence[NDArray[Any]]

PROTOCOL_VERSION = 5  # increase if the same localizer gets other results
LINES = ("best-1", "best-10", "best-50", "reg-1", "chosen", "reg-10", "closest", "random", "random-10")
STAGES = ("encode", "match", "fuse", "refine")
TIMED = (*STAGES, "choose")  # "choose": refining the other poses of chosen and reg-10, and choosing the best
MOST, FEW = 50, 10  # candidates of best-50, and of best-10, chosen, reg-10 and random-10
NEAR = 32  # grid poses nearest by root mean square distance, among which the nearest by ADD is sought
SHARD = 25  # touches located and saved at once
MEASURED = ("errors_m", "T_sensor_object", "seconds", "posterior_metrics")
ARRAYS = (*MEASURED, "T_true", "refused")


@dataclass(frozen=True, eq=False)
class TouchEvaluator:
    """Locates touches with known poses on a localizer's object, and measures every line of the protocol."""

    localizer: Localizer

    def measure(self, touch: Touch, rng: np.random.Generator) -> Arrays:
        """Locate a touch with a known pose and return the arrays MEASURED.

        These are the ADD (L,) and the poses (L, 4, 4), metres, of LINES, seconds (S,) of TIMED, and POSTERIOR_METRICS.
        `rng` draws the random poses. The time of refinement is the time for one pose. Raises TouchError without a true
        pose.
        """
        truth = require_true_pose(touch)
        times = StageTimes()
        posterior = self.localizer.posterior(touch, times=times)
        top = posterior.top(MOST)
        top = top[np.isfinite(posterior.log_p[top])]
        guesses = rng.integers(len(posterior.grid), size=FEW)
        refined, chosen = self._refine(touch, posterior, top[:FEW], times)
        errors_m, poses = self._choose_lines(posterior.grid, truth, top, guesses, refined, chosen)
        seconds = np.array([times.seconds[stage] for stage in TIMED])
        return errors_m, poses, seconds, measure_posterior(posterior, truth, rng)

    def _refine(self, touch: Touch, posterior: PosePosterior, top: Ints, times: StageTimes) -> tuple[Poses, int]:
        """Refine the grid poses `top` (K,); return them (K, 4, 4), metres, and the number of the best one.

        Add the time of the first pose to `times` as "refine", and that of the others and of the choice as "choose".
        """
        with times.stage("refine"):
            (first,) = self.localizer.refine(touch, posterior, [int(top[0])])
        with times.stage("choose"):
            others = self.localizer.refine(touch, posterior, [int(index) for index in top[1:]])
            refined = np.stack([pose.T_sensor_object for pose in (first, *others)])
            return refined, int(self.localizer.scene.imprint_ious(refined, touch).argmax())

    def _choose_lines(
        self, grid: PoseGrid, T_true: Poses, top: Ints, guesses: Ints, refined: Poses, chosen: int
    ) -> tuple[Floats, Poses]:
        """Return the ADD (L,) and the pose (L, 4, 4), metres, of each line: its candidate nearest to the true pose."""
        near = np.argsort(grid.distances(T_true), kind="stable")[:NEAR]
        on_grid = np.concatenate([top, guesses, near])
        poses = np.concatenate([grid.T_sensor_object[on_grid], refined])
        errors_m = compute_adds(self.localizer.object, self._points_m, poses, T_true)
        k, n = len(top), len(on_grid)
        choices = {
            "best-1": (0, 1),
            "best-10": (0, min(FEW, k)),
            "best-50": (0, k),
            "reg-1": (n, n + 1),
            "chosen": (n + chosen, n + chosen + 1),
            "reg-10": (n, len(poses)),
            "closest": (0, n),
            "random": (k, k + 1),
            "random-10": (k, k + FEW),
        }
        best = [a + errors_m[a:b].argmin() for a, b in (choices[line] for line in LINES)]
        return errors_m[best], poses[best]

    @cached_property
    def _points_m(self) -> Floats:
        return PoseJudge(self.localizer.object).points_m


def evaluate(localizer: Localizer, count: int, touches: SimulatedTouches) -> ExampleTable:
    """Locate the first `count` of the simulated touches and measure all LINES.

    The table has a row for each touch, with the ADD of LINES, the columns STAGE_s (the durations of TIMED), and
    POSTERIOR_METRICS. `T_sensor_object` (T, L, 4, 4), metres, is each line's final pose, and `T_true` (T, 4, 4) the
    true pose. `refused` is the number of presses before each touch that made no touch and do not count.

    The result is kept in the localizer's store, in shards of SHARD touches. An interrupted evaluation resumes with the
    same errors. All encoders get the same touches and the same random poses. Raises TactileLocError if a touch cannot
    be located.
    """
    evaluator, key = TouchEvaluator(localizer), make_evaluation_key(localizer, count, touches)
    arrays = measure_in_shards(localizer.store, key, ARRAYS, count, SHARD, partial(_localise, evaluator, touches))
    errors_m, seconds, metrics = (arrays.pop(name) for name in ("errors_m", "seconds", "posterior_metrics"))
    columns = {
        **name_errors(errors_m[..., None], LINES, ("add",)),
        **{f"{stage}_s": seconds[:, k] for k, stage in enumerate(TIMED)},
        **{name: metrics[:, k] for k, name in enumerate(POSTERIOR_METRICS)},
        **arrays,
    }
    return ExampleTable.make(columns, **label_run(localizer, touches), example=np.arange(count), touches=1)


def label_run(localizer: Localizer, touches: SimulatedTouches) -> dict[str, Any]:
    """Return the columns that are the same for all simulated touches of a localizer's object."""
    return {
        "object": localizer.object.name,
        "symmetry": str(localizer.object.symmetry),
        "encoder": localizer.config.encoder.name,
        "noise": touches.noise,
        "seed": touches.seed,
        "grid_poses": localizer.model.size,
    }


def make_evaluation_key(localizer: Localizer, count: int, touches: SimulatedTouches) -> StageKey:
    """Return the store key of an evaluation, made from all inputs of its errors."""
    refiner = {"refiner": localizer.refinement.refiner.describe()}
    return StageKey("evaluation", PROTOCOL_VERSION, {**describe_located(localizer, touches, count), **refiner})


def _localise(evaluator: TouchEvaluator, source: SimulatedTouches, numbers: Sequence[int]) -> list[NDArray[Any]]:
    """Return the ARRAYS of some touches."""
    localizer = evaluator.localizer
    touches, refused = zip(*(source.draw_counted(localizer, number) for number in numbers), strict=True)
    for touch in touches:
        localizer.listed.matcher(touch.press_depth_m)  # built now, because the time of a touch must not include it
    localizer.find_most_probable_pose(touches[0])  # libraries are loaded now, too
    rows = []
    what = f"{localizer.object.name} ({localizer.config.encoder.name})"
    task = f"locating {what}, touches {numbers[0] + 1} to {numbers[-1] + 1}"
    with localizer.progress.task(task, len(touches)) as advance:
        for number, touch in zip(numbers, touches, strict=True):
            rows.append(evaluator.measure(touch, np.random.default_rng(source.seed_touch(number, 1))))
            advance(1)
    return [
        *map(np.stack, zip(*rows, strict=True)),
        np.stack([require_true_pose(touch) for touch in touches]),
        np.array(refused),
    ]


def measure_in_shards(
    store: StageStore, key: StageKey, names: Sequence[str], count: int, size: int, make: Callable[[range], Arrays]
) -> dict[str, NDArray[Any]]:
    """Return the arrays `names`, each with a row for each of `count` numbers, from the store or made now.

    `make` takes a range of at most `size` numbers, and returns an array of their rows for each name. Shards that an
    interrupted run saved are loaded.
    """

    def run(work: Workspace) -> None:
        every = range(count)
        shards = [_make_shard(work, names, every[start : start + size], make) for start in every[::size]]
        for name, columns in zip(names, zip(*shards, strict=True), strict=True):
            work.save_array(name, np.concatenate(columns))

    artifact = store.build(key, run)
    return {name: artifact.load_array(name, mmap=False) for name in names}


def _make_shard(work: Workspace, names: Sequence[str], numbers: range, make: Callable[[range], Arrays]) -> Arrays:
    """Return the arrays of some numbers, made now, or loaded if an interrupted run saved them."""
    own = [f"{name}-{numbers.start:06d}" for name in names]
    found: Arrays = [array for array in (work.load(name, keep=False) for name in own) if array is not None]
    if len(found) < len(own):
        found = make(numbers)
        for name, array in zip(own, found, strict=True):
            work.save_array(name, array, keep=False)
    return found


def describe_located(localizer: Localizer, touches: SimulatedTouches, count: int) -> dict[str, Any]:
    """Return all inputs of the posteriors of `count` simulated touches, also fused, as JSON values."""
    components = localizer.describe_components()
    return {
        **localizer.source.describe_scores(),
        "temperature_scaling": asdict(localizer.source.temperature_scaling),
        "matcher": components["matcher"],
        "fuser": components["fuser"],
        **touches.describe(localizer),
        "count": count,
    }
