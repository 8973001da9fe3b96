"""Each check notices a component that breaks its contract, and reports it in one sentence."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import pytest
from broken_components import BROKEN

from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.plugins.refiners.none import NoRefiner
from tactile_loc.slots.component import Capabilities
from tactile_loc.slots.registry import SLOTS
from tactile_loc.testing import (
    ContractError,
    contract,
    encoders,
    fusers,
    grids,
    list_checks,
    matchers,
    parametrize_with_checks,
    refiners,
    renderers,
    sensors,
)
from tactile_loc.testing.contract import CHECKS, PROPERTY

MODULES = (contract, sensors, renderers, grids, encoders, matchers, refiners, fusers)


@pytest.mark.parametrize(("check", "component"), BROKEN, ids=lambda x: getattr(x, "name", type(x).__name__))
def test_a_broken_component_is_noticed(check, component):
    with pytest.raises(ContractError) as caught:
        check(component)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert len(sentence) > 30


def test_every_check_has_a_broken_component():
    assert all(MODULES)  # they are imported
    checks = {(one.slot, one.name) for one in CHECKS if one.slot in ("", *SLOTS) and not one.is_property}
    assert {(check.slot, check.name) for check, _ in BROKEN} == checks


def test_every_tag_is_a_capability_and_every_check_has_a_sentence():
    fields = {field.name for field in dataclasses.fields(Capabilities)}
    for check in CHECKS:
        assert {tag.removeprefix("not ") for tag in check.tags} <= {*fields, PROPERTY}
        assert check.demands.endswith((".", ":"))


def test_checks_follow_the_capabilities():
    names = {check.name for check in list_checks(NoRefiner())}
    assert "check_truth_stays" in names
    assert "check_offsets_shrink" not in names


def test_a_class_is_refused():
    with pytest.raises(TypeError, match="DenseMatcher"):
        list_checks(DenseMatcher)  # type: ignore[arg-type]


def test_parametrize_makes_one_case_per_check():
    mark = parametrize_with_checks([DenseMatcher(), NoRefiner()]).mark
    names, cases = mark.args
    assert names == ("component", "check")
    assert len(cases) == len(list_checks(DenseMatcher())) + len(list_checks(NoRefiner()))
    assert cases[0].id.startswith("DenseMatcher-check_")


@pytest.mark.slow
def test_an_import_needs_neither_pytest_nor_heavy_libraries():
    code = (
        "import sys; sys.modules['pytest'] = None; import tactile_loc.testing as t;"
        "from tactile_loc.plugins.refiners.none import NoRefiner;"
        "[check(NoRefiner()) for check in t.list_checks(NoRefiner())];"
        "assert not {'open3d', 'torch', 'trimesh', 'faiss'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
