"""Plugins written for another version of the interface are refused in one sentence."""

from collections.abc import Iterator

import numpy as np
import pytest
import strange_matchers
from strange_matchers import Listed, Plain, installed

from tactile_loc.core.runtime.errors import PluginLoadError
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.sources.scoring import LiftedMatcher
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.slots.interface import INTERFACE_VERSION, WEIGHTS_CHANGE, takes_weights
from tactile_loc.slots.registry import BUILT_IN, ComponentSpec, Registry, registry
from tactile_loc.testing.running import run_checks

FEW = {"grid": {"name": "whole", "directions": 200}, "temperature": 0.05}
LISTED = {"grid": {"name": "face", "spacing_mm": 6.0}, "temperature": 0.05}


@pytest.fixture(autouse=True)
def strangers() -> Iterator[None]:
    with installed():
        yield


def test_built_in_components_have_the_current_interface():
    own = [found.spec for found in registry().components if found.distribution == BUILT_IN]
    assert {spec.interface for spec in own} == {INTERFACE_VERSION}


@pytest.mark.parametrize("interface", [0, "2", None])
def test_an_interface_must_be_a_positive_whole_number(monkeypatch, interface):
    odd = ComponentSpec("matcher", "odd", "odd:Odd", "odd", interface=interface)
    monkeypatch.setitem(strange_matchers.SPECS, "odd", odd)
    (failure,) = Registry([strange_matchers.Stranger()]).failures
    assert "interface must be a whole number" in failure.error


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("ahead", ("needs plugin interface 99", "pip install --upgrade tactile-loc")),
        ("behind", ("was written for plugin interface 1", "update strange-matchers")),
    ],
)
def test_a_plugin_of_another_interface_is_refused_in_one_sentence(name, told):
    with pytest.raises(PluginLoadError) as caught:
        registry().create("matcher", name)
    for part in (*told, f"this tactile-loc has {INTERFACE_VERSION}", f"'{name}' of strange-matchers"):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_plugin_without_a_version_has_the_first_interface():
    assert ComponentSpec("matcher", "old", "old:Old", "from before there were versions").interface == 1


@pytest.mark.parametrize("kind", [Plain, DenseMatcher])
def test_the_signature_shows_whether_a_matcher_takes_weights(kind):
    assert takes_weights(kind) == takes_weights(kind()) == (kind is DenseMatcher)


def test_a_matcher_that_takes_no_weights_must_declare_it():
    with pytest.raises(PluginLoadError, match=WEIGHTS_CHANGE):
        registry().load("matcher", "forgetful")


def test_a_matcher_without_weights_passes_the_other_checks():
    results = {result.name: result for result in run_checks(Listed())}
    assert all(result.passed for result in results.values())
    assert "check_weights" not in results


def test_a_matcher_without_weights_scores_listed_poses(store):
    localizer = Localizer.create("pin", store=store, matcher="listed", **LISTED)
    touch = localizer.simulate(1, seed=2)[0]
    exact = Localizer.create("pin", store=store, matcher="dense", **LISTED)
    found, wanted = (one.source.score(touch, StageTimes())[1] for one in (localizer, exact))
    assert found == pytest.approx(wanted, abs=1e-5)


def test_a_matcher_without_weights_scores_places_like_an_exact_matcher(store):
    localizer, exact = (Localizer.create("pin", store=store, matcher=name, **FEW) for name in ("listed", "dense"))
    touch = localizer.simulate(1, seed=2)[0]
    found, wanted = (one.source.place_search.alike(touch, 200) for one in (localizer, exact))
    assert {pose.tobytes() for pose in found[0]} == {pose.tobytes() for pose in wanted[0]}
    assert np.sort(found[1]) == pytest.approx(np.sort(wanted[1]), abs=1e-4)
    best, right = (one.localize(touch).best.T_sensor_object for one in (localizer, exact))
    np.testing.assert_allclose(best, right, atol=1e-6)


def test_weights_are_lifted_by_the_contract():
    results = {result.name: result for result in run_checks(LiftedMatcher(Listed()))}
    assert "check_weights" in results
    assert [name for name, result in results.items() if not result.passed] == []
