"""Several contacts on a coarse grid: the effect of each further contact, and resuming with the same results."""

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import ExampleTable, Localizer, PosePosterior, StageStore
from tactile_loc.core.poses.pose_errors import compute_adds
from tactile_loc.evaluation.paper.fusion import FUSED_LINES, FUSION_LINES, evaluate_fusion, make_fusion_key
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.summary import find_scale_m, normalise_errors
from tactile_loc.evaluation.table import MOST_FUSED
from tactile_loc.plugin import ConfigError, NoPoseLeft
from tactile_loc.plugin.helpers import invert
from tactile_loc.plugins.fusers.kinematic import KinematicFuser
from tactile_loc.plugins.fusers.product import ProductFuser

COUNT, CONTACTS = 4, (1, 2, 4)
SOURCE = SimulatedTouches("strong", 3)


def fresh(store: StageStore, **settings) -> Localizer:
    grid, sensor = {"name": "face", "spacing_mm": 8}, {"name": "gelslim", "gel": "rigid"}
    settings = {"temperature": 0.05, "refiner": "none", **settings}  # no temperature is fitted
    return Localizer.create("elbow_pipe", grid=grid, sensor=sensor, store=store, **settings)


@pytest.fixture(scope="module")
def pipe(store: StageStore) -> Localizer:
    return fresh(store)


@pytest.fixture(scope="module")
def evaluation(pipe: Localizer) -> ExampleTable:
    return evaluate_fusion(pipe, CONTACTS, COUNT, SOURCE)


def errors_m(table: ExampleTable, line: str, contacts: int) -> np.ndarray:
    return table.group("touches")[contacts,].errors_m(line, "add")


def shares(table: ExampleTable, line: str, contacts: int) -> np.ndarray:
    return errors_m(table, line, contacts) / find_scale_m(table)


def count_alone(table: ExampleTable, line: str, contacts: int) -> int:
    return int(table.group("touches")[contacts,][f"{line} alone"].sum())


def assert_same(a: ExampleTable, b: ExampleTable) -> None:
    """Both have the same results for the examples of the first."""
    b = b.select(b["example"] <= a["example"].max())
    for name in (*(f"{line} add_m" for line in FUSION_LINES), *(f"{line} alone" for line in FUSED_LINES)):
        assert (a[name] == b[name]).all()


def nearest(localizer: Localizer, touch) -> int:
    return int(localizer.model.grid.nearest(touch.T_sensor_object[None])[1][0])


def certain(localizer: Localizer, touch) -> PosePosterior:
    """A posterior that is certain of the grid pose nearest to the truth."""
    grid = localizer.model.grid
    log_p = np.full(len(grid), -30.0)
    log_p[nearest(localizer, touch)] = 0.0
    return PosePosterior(grid, log_p)


def test_errors_exist_for_every_example_contact_count_and_line(evaluation):
    labels = list(zip(evaluation["example"], evaluation["touches"], strict=True))
    assert labels == [(e, n) for e in range(COUNT) for n in CONTACTS]
    assert all((evaluation.errors_m(line, "add") >= 0).all() for line in FUSION_LINES)
    assert normalise_errors(evaluation, "random").mean() == pytest.approx(1)


def test_errors_are_those_of_the_single_touch_and_of_the_fused_posterior(evaluation, pipe):
    points_m = pipe.object.mesh.sample(20_000, np.random.default_rng(9))

    def measure_error_m(posterior: PosePosterior, touch) -> float:
        T = pipe.model.grid.T_sensor_object[int(posterior.log_p.argmax())]
        return compute_adds(pipe.object, points_m, T[None], touch.T_sensor_object)

    for example in range(COUNT):
        touch = SOURCE.draw_touch(pipe, MOST_FUSED * example)
        error_m = measure_error_m(pipe.posterior_alone(touch), touch)
        assert errors_m(evaluation, "best-1", 1)[example] == pytest.approx(error_m, rel=0.03)
    assert count_alone(evaluation, "best-1", 1) == 0
    touches = [SOURCE.draw_touch(pipe, MOST_FUSED * 2 + k) for k in range(4)]
    fused = pipe.fuser.fuse(list(map(pipe.posterior_alone, touches)), [invert(t.T_sensor_object) for t in touches])
    assert errors_m(evaluation, "best-1", 4)[2] == pytest.approx(measure_error_m(fused, touches[0]), rel=0.03)


def test_refinement_to_all_contacts_reduces_the_error(evaluation, store):
    refined = fresh(store, refiner="joint")
    found = evaluate_fusion(refined, (1, 4), COUNT, SOURCE)
    assert (errors_m(evaluation, "reg-1", 4) == errors_m(evaluation, "best-1", 4)).all()
    assert (errors_m(found, "best-1", 4) == errors_m(evaluation, "best-1", 4)).all()
    assert np.median(errors_m(found, "reg-1", 4)) < 0.5 * np.median(errors_m(found, "best-1", 4))


def test_more_contacts_reduce_the_error_and_kinematic_errors_stay_large(pipe):
    found = evaluate_fusion(pipe, (1, 5), 9, SOURCE)
    assert errors_m(found, "best-1", 5).mean() < errors_m(found, "best-1", 1).mean()
    assert errors_m(found, "kinematic", 5).mean() > 1.5 * errors_m(found, "best-1", 5).mean()
    assert shares(found, "kinematic", 1).mean() == pytest.approx(1, abs=0.4)  # one contact excludes no pose


def test_later_touches_compensate_an_uninformative_first_touch(monkeypatch, store):
    localizer = fresh(store, temperature=0.2)

    def first_knows_nothing(self, touch):
        nothing = PosePosterior(self.model.grid, np.zeros(len(self.model.grid)))
        return certain(self, touch) if int(touch.name[-4:]) % MOST_FUSED else nothing

    monkeypatch.setattr(Localizer, "posterior_alone", first_knows_nothing)
    found = evaluate_fusion(localizer, (1, 4), 6, SOURCE)
    assert np.median(shares(found, "best-1", 4)) < 0.25 < np.median(shares(found, "best-1", 1))


def test_contacts_without_a_common_pose_are_counted_and_located_from_the_first(monkeypatch, pipe, evaluation):
    def refuse(self, posteriors, poses, prior=None, *, fuse):
        if len(posteriors) == 4:
            return NoPoseLeft("no pose touches all sensors")
        return fuse(self, posteriors, poses, prior)

    for fuser in (ProductFuser, KinematicFuser):
        monkeypatch.setattr(fuser, "fuse", lambda *a, f=fuser.fuse, **k: refuse(*a, **k, fuse=f))
    found = evaluate_fusion(pipe, CONTACTS, 3, SOURCE)
    assert [count_alone(found, "best-1", n) for n in CONTACTS] == [0, 0, 3]
    assert count_alone(found, "kinematic", 4) == 3
    assert (errors_m(found, "best-1", 4) == errors_m(evaluation, "best-1", 1)[:3]).all()
    assert (errors_m(found, "best-1", 2) == errors_m(evaluation, "best-1", 2)[:3]).all()


def test_equal_seeds_give_equal_errors_for_any_contact_counts_and_other_seeds_give_other_errors(evaluation, pipe):
    assert_same(evaluate_fusion(fresh(pipe.store), CONTACTS, 2, SOURCE), evaluation)
    found = evaluate_fusion(pipe, (2,), 2, SOURCE)
    for line in FUSION_LINES:
        assert (errors_m(found, line, 2) == errors_m(evaluation, line, 2)[:2]).all()
    other = evaluate_fusion(pipe, CONTACTS, 2, SimulatedTouches("strong", 4))
    assert not np.allclose(errors_m(other, "best-1", 1), errors_m(evaluation, "best-1", 1)[:2])


def test_refused_presses_are_counted(pipe, monkeypatch):
    drawn = SimulatedTouches.draw_counted

    def after_refusals(self, localizer, number):
        return drawn(self, localizer, number)[0], number

    monkeypatch.setattr(SimulatedTouches, "draw_counted", after_refusals)
    found = evaluate_fusion(pipe, (3,), 2, SOURCE)
    assert found["refused"].tolist() == [0 + 1 + 2, 3 * MOST_FUSED + 0 + 1 + 2]


@pytest.mark.slow
def test_the_key_contains_every_input_that_changes_the_errors(pipe):
    def digest(local=pipe, contacts=CONTACTS, count=COUNT, source=SOURCE):
        return make_fusion_key(local, contacts, count, source).digest

    others = [digest(contacts=(1, 2)), digest(count=7), digest(source=SimulatedTouches("mild", 3))]
    fuser, encoder = {"name": "product", "doubt": 0.1}, {"name": "pixel", "cells": 10}
    for settings in ({"fuser": fuser}, {"encoder": encoder}, {"refiner": "icp"}):
        others.append(digest(fresh(pipe.store, **settings)))
    assert digest() == digest(fresh(pipe.store))
    assert len({digest(), *others}) == 7


@pytest.mark.parametrize("contacts", [(), (0, 1), (1, MOST_FUSED + 1), (-2,)])
def test_impossible_contact_counts_are_refused(pipe, contacts):
    with pytest.raises(ConfigError, match=naming("contacts", list(contacts), MOST_FUSED)):
        evaluate_fusion(pipe, contacts, 1, SOURCE)
