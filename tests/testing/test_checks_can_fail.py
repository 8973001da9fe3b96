"""Each check and property notices a component that breaks its contract, and reports it in one sentence."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from broken_components import BROKEN, CAUSES, drawing, made, then

from tactile_loc.plugins.grids.face import FaceGrid
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
    list_properties,
    matchers,
    parametrize_with_checks,
    parametrize_with_properties,
    refiners,
    renderers,
    sensors,
)
from tactile_loc.testing.contract import CHECKS, PROPERTY
from tactile_loc.testing.problems import make_block
from tactile_loc.testing.running import run_checks

MODULES = (contract, sensors, renderers, grids, encoders, matchers, refiners, fusers)


@pytest.mark.parametrize(("check", "component"), BROKEN, ids=lambda x: getattr(x, "name", type(x).__name__))
def test_a_broken_component_is_noticed(check, component):
    with pytest.raises(ContractError) as caught:
        check(component)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert len(sentence) > 30
    assert not check.is_property or "=" in sentence, "the message lacks the values of its case"


@pytest.mark.parametrize(("check", "component", "words"), CAUSES, ids=lambda x: getattr(x, "name", ""))
def test_the_message_names_the_cause(check, component, words):
    with pytest.raises(ContractError) as caught:
        check(component)
    assert words in str(caught.value).partition("; ")[2]


def test_not_a_number_equals_itself():
    component = drawing(lambda depth, *_: np.where(np.isinf(depth), np.float32(np.nan), depth))
    renderers.check_deterministic(component)
    with pytest.raises(ContractError):
        renderers.check_output(component)


def test_an_input_that_one_check_lets_change_is_new_in_the_next():
    def shifting(poses, obj, *_):
        obj.mesh.vertices_m[:] += 1e-3
        return poses

    before = make_block().mesh.vertices_m.copy()
    grids.check_poses_are_rigid(then(FaceGrid, "sample", shifting))
    assert np.array_equal(make_block().mesh.vertices_m, before)


def test_an_error_in_every_case_is_not_blamed_on_a_difficult_one():
    def fails(self, touch, candidate, scene):
        raise RuntimeError("no such attribute")

    with pytest.raises(RuntimeError, match="no such attribute"):
        refiners.check_degenerate_contact(made(NoRefiner, refine=fails))


def test_the_cause_of_poses_that_do_not_touch_is_not_guessed():
    beside = then(FaceGrid, "sample", lambda T, *_: T + np.pad([[0.3]], ((0, 3), (3, 0))))
    with pytest.raises(ContractError) as caught:
        grids.check_poses_reach_contact(beside)
    assert "cause" not in str(caught.value)


def test_every_check_has_a_broken_component():
    assert all(MODULES)  # they are imported
    checks = {(one.slot, one.name) for one in CHECKS if one.slot in ("", *SLOTS)}
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


@pytest.mark.parametrize("take", [list_checks, list_properties, run_checks])
def test_a_class_is_refused(take):
    with pytest.raises(TypeError, match="DenseMatcher"):
        take(DenseMatcher)


@pytest.mark.parametrize(
    ("parametrize", "listing", "kind"),
    [(parametrize_with_checks, list_checks, "check"), (parametrize_with_properties, list_properties, "property")],
)
def test_parametrize_makes_one_case_per_check(parametrize, listing, kind):
    names, cases = parametrize([DenseMatcher(), NoRefiner()]).mark.args
    assert names == ("component", "check")
    assert len(cases) == len(listing(DenseMatcher())) + len(listing(NoRefiner()))
    assert cases[0].id.startswith(f"DenseMatcher-{kind}_")


@pytest.mark.slow
def test_an_import_needs_neither_pytest_nor_heavy_libraries():
    code = (
        "import sys; sys.modules['pytest'] = None; import tactile_loc.testing as t;"
        "from tactile_loc.plugins.refiners.none import NoRefiner;"
        "[check(NoRefiner()) for check in t.list_checks(NoRefiner())];"
        "assert not {'open3d', 'torch', 'trimesh', 'faiss'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
