"""Identification finds the right object in any order, rejects an unknown one, and locates a single one."""

import dataclasses

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc import Localizer, NullEvidence, RobotTouches, RunConfig, Verdict, localize_together
from tactile_loc.core.runtime.errors import ConfigError, ObjectError, StoreError, TouchError
from tactile_loc.locate import identify as module
from tactile_loc.locate.identify import Identification, KnownObject, identify, measure_misfits
from tactile_loc.plugin.helpers import make_transform, rotation_about
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer

FEW = {"name": "whole", "directions": 300, "turns": 24}

CLEAN = NullEvidence(prior=0.1, noise=1.0)  # of touches without noise


def solids() -> dict[str, trimesh.Trimesh]:
    """Return a plate, a rod and a ring, which all look different."""
    return {
        "plate": trimesh.creation.box((0.03, 0.02, 0.006)),
        "rod": trimesh.creation.cylinder(0.004, 0.04, sections=32),
        "ring": trimesh.creation.annulus(0.006, 0.011, 0.008, sections=32),
    }


@pytest.fixture(scope="module")
def models(make_object, store) -> list[Localizer]:
    config = RunConfig.from_dict({"grid": FEW, "sensor": "gelsight-mini", "temperature": 0.05})
    declared = {"plate": "x2*y2", "rod": "zinf*x2", "ring": "zinf*x2"}
    return [Localizer(config, make_object(s, declared[n], n), store) for n, s in solids().items()]


@pytest.fixture(scope="module")
def touches(models) -> dict[str, list]:
    """Return two touches of each object, from another renderer."""
    renderer, rng = ZBufferRenderer(), np.random.default_rng(3)
    return {
        model.object.name: RobotTouches(model.object, model.scene.geometry, renderer, (0.7, 0.9)).draw_example(2, rng)[
            0
        ]
        for model in models
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", list(solids()))
def test_touches_identify_their_object(models, touches, name):
    said = identify(touches[name], models, null=CLEAN)
    assert said.best is not None
    assert said.best.name == name
    assert sum(one.probability for one in said.objects) + said.none == pytest.approx(1.0)
    assert said.best.misfit == min(one.misfit for one in said.objects)
    assert said.verdict == Verdict.CERTAIN
    assert max(said.floors) < 0.5, "clean touches have no misfit separately"


@pytest.mark.parametrize("name", list(solids()))
def test_touches_of_an_unknown_object_are_rejected(models, touches, name):
    said = identify(touches[name], [model for model in models if model.object.name != name], null=CLEAN)
    assert said.best is None
    assert said.none > 0.5
    assert said.verdict != Verdict.CERTAIN


def test_the_order_of_objects_does_not_matter(models, touches):
    one, other = (identify(touches["ring"][:1], some) for some in (models, models[::-1]))
    assert [o.name for o in one.objects] == [o.name for o in other.objects]
    assert [o.probability for o in one.objects] == [o.probability for o in other.objects]


def test_a_single_object_has_the_result_of_a_localisation(models, touches):
    said = identify(touches["plate"], models[:1])
    alone = localize_together([(models[0], touch) for touch in touches["plate"]])
    found = said.objects[0].found
    assert np.array_equal(found.best.T_sensor_object, alone.best.T_sensor_object)
    assert [h.probability for h in found.hypotheses] == [h.probability for h in alone.hypotheses]


def test_a_pose_that_explains_the_whole_touch_has_no_misfit(models, touches):
    touch = touches["plate"][0]
    found = models[0].localize(touch)
    exact = dataclasses.replace(found.best.refined, T_sensor_object=np.asarray(touch.T_sensor_object))
    true = dataclasses.replace(found, hypotheses=(dataclasses.replace(found.best, refined=exact),))
    assert measure_misfits(models[0], true).sum() < 0.5
    turned = np.asarray(touch.T_sensor_object) @ make_transform(rotation_about([0, 0, 1], 0.3), np.zeros(3))
    wrong = dataclasses.replace(found.best, refined=dataclasses.replace(exact, T_sensor_object=turned))
    assert measure_misfits(models[0], dataclasses.replace(found, hypotheses=(wrong,))).sum() > 0.5


def test_the_verdict_judges_the_first_object(models, touches):
    found = models[0].localize(touches["plate"][0])
    poor = dataclasses.replace(found, assessed=dataclasses.replace(found.assessment, poor_touches=(0,)))

    def judge(p: float, none: float, result) -> Verdict:
        return Identification((KnownObject("plate", p, 0.5, result),), none).verdict

    assert judge(0.95, 0.05, found) == Verdict.CERTAIN
    assert judge(0.6, 0.4, found) == Verdict.AMBIGUOUS
    assert judge(0.3, 0.7, found) == Verdict.NOT_FOUND
    assert judge(0.95, 0.05, poor) == Verdict.POOR_FIT
    assert judge(0.0, 1.0, None) == Verdict.NOT_FOUND


def test_a_full_store_is_an_error_and_not_a_misfit(models, monkeypatch):
    def full(*_: object, **__: object) -> None:
        raise StoreError("full")

    monkeypatch.setattr(module, "localize_together", full)
    with pytest.raises(StoreError, match="full"):
        module._locate(models[0], [])


def test_invalid_touches_and_models_are_refused(models, touches):
    with pytest.raises(ObjectError):
        identify(touches["plate"], [])
    with pytest.raises(ObjectError, match=naming("'pin'", "Localizer.create")):
        identify(touches["plate"], ["pin", "hook"])
    with pytest.raises(ObjectError, match="plate"):
        identify(touches["plate"], [models[0], models[0]])
    with pytest.raises(TouchError):
        identify([], models)
    lost = [dataclasses.replace(touch, T_base_sensor=None) for touch in touches["ring"]]
    with pytest.raises(ConfigError, match=naming("touch 1", "T_base_sensor")):
        identify(lost, models)
