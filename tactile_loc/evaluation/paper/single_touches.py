"""The paper's protocol for one simulated touch: what its tables need beside `protocol.evaluate`."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Poses
from tactile_loc.core.poses.pose_errors import compute_add_s, measure_pose_errors
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.evaluation.metrics import PoseJudge
from tactile_loc.evaluation.paper.ambiguity import choose_judging_noise, make_refiner, measure_ambiguity
from tactile_loc.evaluation.protocol import LINES, SHARD, evaluate, make_evaluation_key, measure_in_shards
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.table import ExampleTable, name_errors
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.keys import StageKey

METRICS = ("add", "mssd", "add-s")
ASKED_EVERY = 10  # step through the surface points, for ADD-S
JUDGED = ("ambiguity", "contact_share")
JUDGED_VERSION, METRICS_VERSION = 1, 1  # increase if the same touches, or the same poses, get other numbers


def evaluate_touches(localizer: Localizer, count: int, touches: SimulatedTouches) -> ExampleTable:
    """Return the table of `evaluate` with the errors of LINES in all METRICS, and with the columns JUDGED.

    `ambiguity` is the ratio of `measure_ambiguity`, and `contact_share`, 0 to 1, is the share of the observed pixels in
    contact. They are the same for all encoders and refiners. All columns are kept in the localizer's store.
    """
    table, judge = evaluate(localizer, count, touches), PoseJudge(localizer.object)

    def measure(numbers: Sequence[int]) -> list[Floats]:
        poses = zip(table["T_sensor_object"][numbers], table["T_true"][numbers], strict=True)
        return [np.stack([_measure_errors(judge, *one) for one in poses])]

    keep = partial(measure_in_shards, localizer.store, count=count, size=SHARD)
    evaluated = make_evaluation_key(localizer, count, touches).digest
    key = StageKey("touch-errors", METRICS_VERSION, {"evaluation": evaluated})
    (errors_m,) = keep(key, ("errors_m",), make=measure).values()
    judged = keep(make_judgement_key(localizer, count, touches), JUDGED, make=partial(_judge, localizer, touches))
    return ExampleTable({**table.columns, **name_errors(errors_m, LINES, METRICS[1:]), **judged})


def make_judgement_key(localizer: Localizer, count: int, touches: SimulatedTouches) -> StageKey:
    """Return the store key of the columns JUDGED, made from all their inputs."""
    inputs = {
        "model": localizer.model.key.digest,
        "sensor": localizer.scene.geometry.describe(),
        "refiner": make_refiner().describe(),
        **touches.describe(localizer),
        "count": count,
    }
    return StageKey("touch-judgement", JUDGED_VERSION, inputs)


def _measure_errors(judge: PoseJudge, poses: Poses, T_true: Poses) -> Floats:
    """Return the METRICS after the first (L, 2), metres, of poses (L, 4, 4); equal poses are measured only once."""
    distinct, where = np.unique(poses.reshape(len(poses), 16), axis=0, return_inverse=True)
    distinct = distinct.reshape(-1, 4, 4)
    pose_errors_m = measure_pose_errors(judge.object, distinct, T_true)
    return np.stack([pose_errors_m, compute_add_s(judge.points_m, distinct, T_true, ASKED_EVERY)], axis=1)[
        where.ravel()
    ]


def _judge(localizer: Localizer, source: SimulatedTouches, numbers: Sequence[int]) -> list[NDArray[np.float64]]:
    """Return the columns JUDGED of some touches."""
    touches = [source.draw_touch(localizer, number) for number in numbers]
    noise = make_noise(choose_judging_noise(source.noise))
    rngs = [np.random.default_rng(source.seed_touch(number, 3)) for number in numbers]
    task = f"judging the ambiguity of {localizer.object.name}, touches {numbers[0] + 1} to {numbers[-1] + 1}"
    with localizer.progress.task(task, len(touches)) as advance:
        ratios = measure_ambiguity(localizer, touches, noise, rngs)
        advance(len(touches))
    return [ratios, np.array([touch.contact_share for touch in touches])]
