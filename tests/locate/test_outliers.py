"""Touches that contradict the others are named, and can be left out."""

import dataclasses

import numpy as np
import pytest
from locate_helpers import list_poses, locate_together
from message_helpers import naming

from tactile_loc import GaussianPrior, Localizer, RunConfig
from tactile_loc.locate.outliers import find_agreement
from tactile_loc.locate.result.localization import Hypothesis
from tactile_loc.plugin import GridError, RefinedPose
from tactile_loc.plugin.helpers import invert, make_transform, rotation_about

ELSEWHERE = make_transform(rotation_about([0, 0, 1], np.radians(30)), [0.006, 0.004, 0.0])


class Search:
    """Return hypotheses with the imprint IoU of each touch from `found`, whose keys are the outliers' numbers."""

    def __init__(self, found: dict[tuple[int, ...], tuple[float, ...]], alone: float = 0.9) -> None:
        self.found, self.alone = found, alone
        self.asked: list[tuple[int, ...]] = []
        self.asked_alone: list[int] = []

    def find(self, outliers: tuple[int, ...]) -> tuple[Hypothesis, ...]:
        self.asked.append(outliers)
        ious = self.look_up(outliers)
        trusted = [iou for number, iou in enumerate(ious) if number not in outliers]
        known = tuple(np.nan if number in outliers else iou for number, iou in enumerate(ious))
        return (hypothesis(float(np.mean(trusted)), known),)

    def look_up(self, outliers: tuple[int, ...]) -> tuple[float, ...]:
        return self.found.get(tuple(sorted(outliers)), (0.0,) * len(self.found[()]))

    def compare_outliers(self, hypotheses, outliers: tuple[int, ...]) -> tuple[Hypothesis, ...]:
        return tuple(dataclasses.replace(h, imprint_ious=self.look_up(outliers)) for h in hypotheses)

    def find_best_iou_alone(self, number: int) -> float:
        self.asked_alone.append(number)
        return self.alone

    def agree(self):
        return find_agreement(self)


def hypothesis(imprint_iou: float, imprint_ious: tuple[float, ...]) -> Hypothesis:
    refined = RefinedPose(np.eye(4), 1.0, True, 3)
    return Hypothesis(1.0, np.eye(4), refined, 0, 1, imprint_iou, imprint_ious)


def test_touches_that_one_pose_explains_agree_without_another_search():
    search = Search({(): (0.9, 0.8, 0.7)})
    found, agreement = search.agree()
    assert (agreement.outliers, agreement.contradictory) == ((), False)
    assert agreement.best_ious == found[0].imprint_ious == (0.9, 0.8, 0.7)
    assert search.asked == [()]
    assert search.asked_alone == []


def test_an_outlier_is_named_and_does_not_affect_the_pose():
    search = Search({(): (0.7, 0.2, 0.7, 0.6), (1,): (0.9, 0.0, 0.9, 0.8)})
    found, agreement = search.agree()
    assert (agreement.outliers, agreement.contradictory) == ((1,), True)
    assert found[0].imprint_ious == (0.9, 0.0, 0.9, 0.8)
    assert found[0].imprint_iou == pytest.approx(np.mean([0.9, 0.9, 0.8]))
    assert agreement.best_ious == (0.9, 0.9, 0.9, 0.8)
    assert search.asked_alone == [1]  # the other touches are explained well enough by the poses tried


def test_a_touch_that_no_pose_explains_better_is_no_contradiction():
    assert not Search({(): (0.7, 0.2, 0.7)}, alone=0.3).agree()[1].contradictory


@pytest.mark.parametrize(
    "found",
    [
        {(): (0.9, 0.1)},  # two touches never name an outlier
        # either of two touches could be the outlier
        {(): (0.5, 0.1, 0.5), (1,): (0.9, 0.0, 0.9), (0,): (0.0, 0.9, 0.9)},
        {(): (0.6, 0.1, 0.6, 0.5), (1,): (0.6, 0.0, 0.6, 0.6)},  # the others hardly agree either: all are noisy
        {(): (0.9, 0.0, 0.9, 0.0), (1,): (0.9, 0.0, 0.9, 0.0)},  # two against two
    ],
)
def test_no_outlier_is_named_without_agreement_of_the_others(found):
    hypotheses, agreement = Search(found).agree()
    assert (agreement.outliers, agreement.contradictory) == ((), True)
    assert hypotheses[0].imprint_ious == found[()]


def test_two_outliers_of_five_touches_are_named():
    five = {(): (0.6, 0.1, 0.6, 0.2, 0.6), (3,): (0.8, 0.0, 0.8, 0.0, 0.8), (1, 3): (0.9, 0.0, 0.9, 0.0, 0.9)}
    found, agreement = Search(five).agree()
    assert agreement.outliers == (1, 3)
    assert found[0].imprint_iou == pytest.approx(0.9)


@pytest.fixture(scope="module")
def block(make_box, store) -> Localizer:
    """A block before a sensor of few pixels; fewer hypotheses than usual are enough for it."""
    sensor, grid = {"name": "gelslim", "image_size_px": [100, 100], "gel": "rigid"}, {"name": "face", "spacing_mm": 5.0}
    coarse = {"sensor": sensor, "grid": grid, "temperature": 1e-3, "hypotheses": {"refined_together": 8}}
    return Localizer(RunConfig.from_dict(coarse), make_box(0.024, 0.014, 0.008, symmetry="z2"), store)


@pytest.fixture(scope="module")
def touches(block):
    """Four touches of a block that lies at the base's origin."""
    simulated = block.simulate(4, seed=1, noise="mild")
    return [dataclasses.replace(touch, T_base_sensor=invert(touch.T_sensor_object)) for touch in simulated]


def with_moved(touches, number: int):
    """Return the touches, one with a wrong sensor pose."""
    moved = dataclasses.replace(touches[number], T_base_sensor=touches[number].T_base_sensor @ ELSEWHERE)
    return [*touches[:number], moved, *touches[number + 1 :]]


def dropping(block: Localizer) -> Localizer:
    config = block.config.model_copy(update={"drop_outliers": True})
    return Localizer(config, block.object, block.store)


def error_m(block, found) -> float:
    """Return the error of an object that lies at the base's origin."""
    T = found.touch.T_base_sensor @ found.best.T_sensor_object
    return float(block.model.grid.metric.symmetric_distance(T[None], np.eye(4)[None])[0])


def test_a_touch_with_a_wrong_sensor_pose_is_named_and_does_not_shift_the_pose(block, touches):
    found = locate_together(block, with_moved(touches, 1))
    assert [touch.name for touch in found.outliers] == [touches[1].name]
    assert found.best.imprint_ious[1] < 0.5 < found.agreement.best_ious[1]
    assert found.best.imprint_iou == pytest.approx(np.mean([found.best.imprint_ious[k] for k in (0, 2, 3)]))
    assert found.left_out == ()
    assert error_m(block, found) < 1e-3
    assert locate_together(block, with_moved(touches, 1)[:2]).outliers == ()


@pytest.mark.parametrize("wrong", [0, 1])
def test_leaving_out_an_outlier_gives_the_result_without_it(block, touches, wrong):
    given = with_moved(touches, wrong)
    rest = [touch for number, touch in enumerate(given) if number != wrong]
    found, alone = locate_together(dropping(block), given), locate_together(block, rest)
    assert found.left_out == (given[wrong],)
    assert found.touches == tuple(rest)
    np.testing.assert_array_equal(found.posterior.log_p, alone.posterior.log_p)
    np.testing.assert_array_equal(list_poses(found), list_poses(alone))


def test_the_prior_stays_right_if_the_first_touch_is_left_out(block, touches):
    given = with_moved(touches, 0)
    of_second = GaussianPrior(np.asarray(touches[1].T_sensor_object), 2e-3, 0.1, block.object.symmetry)
    T_second_first = invert(given[1].T_base_sensor) @ given[0].T_base_sensor
    found = locate_together(dropping(block), given, prior=lambda T: of_second(T_second_first @ T))
    alone = locate_together(block, given[1:], prior=of_second)
    assert found.left_out == (given[0],)
    here, there = (one.log_p - np.log1p(-one.elsewhere) for one in (found.posterior, alone.posterior))
    np.testing.assert_allclose(here, there, atol=1e-9)


def test_a_sensor_out_of_reach_is_named(block, touches):
    far = dataclasses.replace(touches[2], T_base_sensor=make_transform(np.eye(3), [5.0, 0.0, 0.0]), name="far away")
    given = [touches[0], touches[1], far]
    with pytest.raises(GridError, match=naming("far away", "`drop_outliers`")):
        locate_together(block, given)
    assert locate_together(dropping(block), given).left_out == (far,)
    with pytest.raises(GridError, match=naming("box", "29 mm")) as raised:
        locate_together(dropping(block), [touches[0], far])
    assert "`drop_outliers`" not in str(raised.value)
