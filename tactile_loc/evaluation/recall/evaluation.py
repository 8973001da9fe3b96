"""Evaluation of what `run` answers: examples are located from 1 to N touches, and every listed pose is measured."""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Poses, invert
from tactile_loc.core.poses.pose_errors import RIGHT_M
from tactile_loc.core.runtime.errors import GridError, TouchError
from tactile_loc.evaluation.metrics import METRICS, PoseJudge
from tactile_loc.evaluation.protocol import measure_in_shards
from tactile_loc.evaluation.recall.examples import ExampleSource, TouchedExample, measure_true_ious
from tactile_loc.evaluation.simulated_touches import require_true_pose
from tactile_loc.evaluation.table import ExampleTable, name_errors, sort_numbers
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.probability.outcome_model import load_outcome_model
from tactile_loc.locate.result.freedom import explain_as_well
from tactile_loc.locate.result.localization import Hypothesis, Localization
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.verdict import REFUSED
from tactile_loc.locate.several_touches import Observation, localize_together
from tactile_loc.locate.sources.source import STAGE_VERSIONS
from tactile_loc.store.keys import StageKey

RECALL_VERSION = 4  # increase if verdicts or the method change without a change of key
SHARD = 5  # examples located and saved at once
ABSENT = ""  # verdict of an example that has too few touches


class Located(NamedTuple):
    """The result of one example located from some of its touches.

    `errors_m` (2, M), metres, are the METRICS of the first pose, and the least of all listed poses; infinite without a
    pose. `probability` is that of the first pose, NaN without one. `verdict` is a verdict's word, "refused", or ABSENT.
    `problem` is the reason if there is no pose. `determined` is false if a listed wrong pose explains the touches as
    well as the true pose. `seconds` is the time to locate the example, NaN if there is no pose.
    """

    errors_m: Floats
    probability: float
    verdict: str
    problem: str
    determined: bool
    seconds: float


ARRAYS = (*Located._fields, "refused")


def evaluate_recall(localizer: Localizer, examples: ExampleSource, together: Sequence[int]) -> ExampleTable:
    """Locate each example from its first n touches, for each n of `together`, and measure all listed poses.

    The table has a row for each example and each number of touches that it has. The errors are those of the `first` and
    the nearest `listed` pose in METRICS. Its further columns are the fields of `Located`.

    The result is kept in the localizer's store, in shards of SHARD examples. An interrupted evaluation resumes. An
    example that cannot be located is kept, with its reason. Raises ConfigError unless all numbers are from 1 to
    MOST_FUSED.
    """
    numbers = sort_numbers(together, "touches")
    key, locator = make_recall_key(localizer, examples, numbers), _ExampleLocator(localizer, examples, numbers)
    arrays = measure_in_shards(localizer.store, key, ARRAYS, examples.count, SHARD, locator.locate_examples)
    return _make_table(localizer, examples, numbers, arrays)


def _make_table(
    localizer: Localizer, examples: ExampleSource, together: tuple[int, ...], arrays: Mapping[str, NDArray[Any]]
) -> ExampleTable:
    """Return the table of the arrays of all examples (E, C, ...), or (E, ...) if they are the same for all touches."""
    shape = arrays["verdict"].shape
    located = {name: arrays[name].reshape(-1, *arrays[name].shape[2:]) for name in Located._fields}
    table = ExampleTable.make(
        {**name_errors(located.pop("errors_m"), ("first", "listed"), METRICS), **located},
        refused=np.repeat(arrays["refused"], len(together)),
        object=localizer.object.name,
        symmetry=str(localizer.object.symmetry),
        diameter_m=PoseJudge(localizer.object).diameter_m,
        encoder=localizer.config.encoder.name,
        example=np.repeat(np.arange(shape[0]), shape[1]),
        touches=np.tile(together, shape[0]),
        **examples.labels,
    )
    return table.select(table["verdict"] != ABSENT)


def make_recall_key(localizer: Localizer, examples: ExampleSource, together: Sequence[int]) -> StageKey:
    """Return the store key of an evaluation, made from all inputs of its results."""
    settings = {key: value for key, value in localizer.config.resolve().items() if key not in ("object", "touch")}
    inputs = {
        **localizer.source.describe_scores(),
        "object": localizer.object.describe(),
        "settings": settings,
        "components": localizer.describe_components(),
        "stages": dict(STAGE_VERSIONS),
        "scalings": asdict(localizer.source.temperature_scaling),
        "outcomes": load_outcome_model().about["version"],
        "examples": examples.describe(),
        "count": examples.count,
        "together": list(together),
    }
    return StageKey("recall-evaluation", RECALL_VERSION, inputs, localizer.object.name)


@dataclass(frozen=True, eq=False)
class _ExampleLocator:
    """Locates examples, and measures the listed poses."""

    localizer: Localizer
    examples: ExampleSource
    together: tuple[int, ...]

    def locate_examples(self, numbers: range) -> list[NDArray[Any]]:
        """Return the ARRAYS of some examples."""
        _ = self.warm
        drawn = [self.examples.draw(number) for number in numbers]
        rows = []
        task = f"locating {self.localizer.object.name}, examples {numbers[0] + 1} to {numbers[-1] + 1}"
        with self.localizer.progress.task(task, len(numbers) * len(self.together)) as advance:
            for example in drawn:
                row = []
                for n in self.together:
                    row.append(self._locate(example, n))
                    advance(1)
                rows.append(row)
        columns = [np.array([[getattr(one, name) for one in row] for row in rows]) for name in Located._fields]
        return [*columns, np.array([example.refused for example in drawn])]

    @cached_property
    def warm(self) -> bool:
        """True, after the first example was located once.

        So no measured time includes the building of what is stored and loaded.
        """
        first = self.examples.draw(0).observations
        for n in self.together:
            with suppress(GridError, TouchError):
                localize_together(first[:n])
        return True

    def _locate(self, example: TouchedExample, n: int) -> Located:
        """Locate an example from its first n touches."""
        some = example.observations[:n]
        if len(some) < n:
            return self._fail(REFUSED if example.problem else ABSENT, example.problem)
        start = time.perf_counter()
        try:
            found = localize_together(some)
        except (GridError, TouchError) as error:
            return self._fail(LocatedFrame.of_error(error).word, str(error))
        seconds = time.perf_counter() - start
        listed = found.hypotheses[: self.localizer.config.top]
        poses = _view_from_first(some, found)[: len(listed)]
        errors_m = self._judge.measure_errors(poses, require_true_pose(some[0][1]))
        determined = is_determined(some, listed, errors_m[:, METRICS.index("mssd")])
        both_m = np.stack([errors_m[0], errors_m.min(axis=0)])
        return Located(both_m, listed[0].probability, found.verdict.value, "", determined, seconds)

    def _fail(self, verdict: str, problem: str) -> Located:
        """Return the result of an example without a pose. It counts as determined."""
        return Located(np.full((2, len(METRICS)), np.inf), np.nan, verdict, problem, True, np.nan)

    @cached_property
    def _judge(self) -> PoseJudge:
        return PoseJudge(self.localizer.object)


def is_determined(observations: Sequence[Observation], hypotheses: Sequence[Hypothesis], errors_m: Floats) -> bool:
    """Return whether no listed wrong pose explains the touches as well as the true poses do.

    `errors_m` (K,), metres, are the hypotheses' pose errors. A pose is wrong above `RIGHT_M`. Raises TouchError
    if a touch has no true pose.
    """
    true = measure_true_ious(observations)
    ious = np.array([hypothesis.imprint_iou for hypothesis in hypotheses])
    return not bool(((errors_m > RIGHT_M) & explain_as_well(ious, float(np.mean(true)))).any())


def _view_from_first(observations: Sequence[Observation], found: Localization) -> Poses:
    """Return the listed poses (K, 4, 4), metres, in the frame of the first touch's sensor.

    They are already in this frame, unless the first touch was left out as an outlier.
    """
    poses = np.stack([hypothesis.T_sensor_object for hypothesis in found.hypotheses])
    first, used = observations[0][1], found.touch
    if used is first:
        return poses
    return invert(np.asarray(first.T_base_sensor)) @ np.asarray(used.T_base_sensor) @ poses
