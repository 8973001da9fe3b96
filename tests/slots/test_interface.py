"""Plugins written for another version of the interface are adapted if possible, or refused."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np
import pytest
import strange_matchers
from strange_matchers import Listed, Plain, Weighing, installed

from tactile_loc.core.runtime.errors import ConfigError, PluginLoadError
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.locate.localizer import Localizer
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.slots.component import Capabilities
from tactile_loc.slots.interface import INTERFACE_VERSION, WEIGHTS_CHANGE, adapt, takes_weights
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


def test_a_plugin_without_a_version_has_the_first_interface():
    assert ComponentSpec("matcher", "old", "old:Old", "from before there were versions").interface == 1


@pytest.mark.parametrize("interface", [0, "2", None])
def test_an_interface_must_be_a_positive_whole_number(monkeypatch, interface):
    odd = ComponentSpec("matcher", "odd", "odd:Odd", "odd", interface=interface)
    monkeypatch.setitem(strange_matchers.SPECS, "odd", odd)
    (failure,) = Registry([strange_matchers.Stranger()]).failures
    assert "interface must be a whole number" in failure.error


@pytest.mark.parametrize("kind", [Plain, Weighing, DenseMatcher])
def test_the_signature_shows_whether_a_matcher_takes_weights(kind):
    assert takes_weights(kind) == takes_weights(kind()) == (kind is DenseMatcher)


def test_an_old_weighing_matcher_gets_the_new_method(caplog):
    with caplog.at_level(logging.WARNING):
        matchers = [registry().create("matcher", "weighing") for _ in range(3)]
    (record,) = caplog.records  # one warning for three matchers
    assert WEIGHTS_CHANGE in record.getMessage()
    assert "Weighing" in record.getMessage()
    rng = np.random.default_rng(0)
    bank, queries, weights = (rng.uniform(size=(n, 5)).astype(np.float32) for n in (30, 4, 4))
    for matcher in matchers:
        matcher.index(bank)
        assert matcher.capabilities.weights
        assert isinstance(matcher, Weighing)
        truth = DenseMatcher()
        truth.index(bank)
        assert matcher.scores(queries) == pytest.approx(truth.scores(queries), abs=1e-5)
        assert matcher.scores(queries, weights) == pytest.approx(truth.scores(queries, weights), abs=1e-5)
        ones = np.ones_like(weights)
        assert matcher.scores(queries, ones) == pytest.approx(truth.scores(queries), abs=1e-5)


def test_an_adapted_matcher_is_stored_under_its_own_name():
    assert registry().create("matcher", "weighing").describe() == Weighing().describe()


def test_an_old_matcher_passes_the_checks_that_apply_to_it():
    for name, weighs in (("plain", False), ("weighing", True)):
        results = {result.name: result for result in run_checks(registry().create("matcher", name))}
        assert all(result.passed for result in results.values())
        assert ("check_weights" in results) == weighs


def test_current_components_and_other_slots_are_not_adapted():
    assert adapt(DenseMatcher, "matcher", 1) is DenseMatcher
    assert adapt(Plain, "matcher", 2) is Plain
    assert adapt(Plain, "refiner", 1) is Plain


def test_an_old_matcher_without_weights_scores_listed_poses(store):
    localizer = Localizer.create("pin", store=store, matcher="plain", **LISTED)
    touch = localizer.simulate(1, seed=2)[0]
    exact = Localizer.create("pin", store=store, matcher="dense", **LISTED)
    found, wanted = (one.source.score([touch], StageTimes())[0][1] for one in (localizer, exact))
    assert found == pytest.approx(wanted, abs=1e-5)


def test_an_old_matcher_without_weights_is_refused_for_whole_grids(store):
    with pytest.raises(ConfigError) as caught:
        Localizer.create("pin", store=store, matcher="plain", **FEW)
    sentence = str(caught.value)
    assert WEIGHTS_CHANGE in sentence
    assert "'plain'" in sentence
    assert "\n" not in sentence


def test_a_matcher_that_declares_no_weights_is_refused_for_whole_grids(store):
    with pytest.raises(ConfigError, match="'listed'") as caught:
        Localizer.create("pin", store=store, matcher="listed", **FEW)
    assert WEIGHTS_CHANGE not in str(caught.value)
    assert Localizer.create("pin", store=store, matcher="listed", **LISTED).config.matcher.name == "listed"
    assert not Listed.capabilities.weights


def test_an_old_weighing_matcher_finds_the_same_pose_as_dense(store):
    old, dense = (Localizer.create("pin", store=store, matcher=name, **FEW) for name in ("weighing", "dense"))
    touch = dense.simulate(1, seed=5)[0]
    assert old.localize(touch).best.T_sensor_object == pytest.approx(dense.localize(touch).best.T_sensor_object)


def test_a_current_matcher_without_weights_fails_to_load():
    with pytest.raises(PluginLoadError, match=WEIGHTS_CHANGE):
        registry().load("matcher", "forgetful")


def test_a_plugin_of_a_later_interface_is_refused_in_one_sentence():
    with pytest.raises(PluginLoadError) as caught:
        registry().create("matcher", "ahead")
    assert "plugin interface 99" in str(caught.value)
    assert f"this tactile-loc has {INTERFACE_VERSION}" in str(caught.value)
    assert "pip install --upgrade tactile-loc" in str(caught.value)


def test_capabilities_of_the_first_interface_are_ignored():
    old: dict = {"uses_normals": True, "device": "cuda"}
    assert Capabilities(deterministic=False, **old) == Capabilities(deterministic=False)
    with pytest.raises(TypeError, match="divine"):
        Capabilities(divine=True)  # type: ignore[call-arg]
