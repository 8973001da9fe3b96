"""Old names work for one release and warn with the new names."""

from __future__ import annotations

import importlib
import warnings

import numpy as np
import pytest

from tactile_loc.core.runtime.deprecation import REMOVAL, RENAMED, keep_old_names
from tactile_loc.tasks.identify_files import KnownObjectRecord
from tactile_loc.testing.problems import make_block_scene, press_block


@pytest.mark.parametrize("module", RENAMED)
def test_an_old_module_name_gives_the_new_object_and_a_warning(module):
    there = importlib.import_module(module)
    for old, new in RENAMED[module].items():
        with pytest.warns(DeprecationWarning, match=rf"{old} is now {module}\.{new}; .*{REMOVAL}"):
            found = getattr(there, old)
        assert found is getattr(there, new)


@pytest.mark.parametrize("module", RENAMED)
def test_modules_list_new_names_and_no_old_ones(module):
    there = importlib.import_module(module)
    assert set(RENAMED[module].values()) <= set(dir(there))
    assert not set(RENAMED[module]) & set(getattr(there, "__all__", ()))
    with pytest.raises(AttributeError, match=f"module '{module}' has no attribute 'nonsense'"):
        _ = there.nonsense


def test_a_warning_names_the_importing_file():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        from tactile_loc.plugin import translation
    assert np.array_equal(translation([0, 0, 1])[:3, 3], [0, 0, 1])
    assert [w.filename for w in caught] == [__file__] * len(caught)
    assert caught


@keep_old_names(counted="count", amount="number")
class Things:
    number = 3

    def count(self, more: int = 0) -> int:
        return self.number + more


class More(Things):
    def count(self, more: int = 0) -> int:
        return 10 + super().count(more)


@pytest.mark.parametrize(("things", "expected"), [(Things(), 5), (More(), 15)])
def test_old_members_call_the_new_ones_also_in_subclasses(things, expected):
    with pytest.warns(DeprecationWarning, match="Things.counted is now Things.count") as caught:
        assert things.counted(more=2) == expected
    assert caught[0].filename == __file__
    with pytest.warns(DeprecationWarning, match="Things.amount is now Things.number"):
        assert things.amount == 3


def test_scene_and_geometry_keep_their_old_methods():
    scene, problem = make_block_scene(), press_block()
    with pytest.warns(DeprecationWarning, match="is now"):
        old = scene.pressed(1e-3).in_contact(problem.truth[None])[0]
    np.testing.assert_array_equal(old, scene.press(1e-3).bring_to_contact(problem.truth[None])[0])
    with pytest.warns(DeprecationWarning, match="is now"):
        assert scene.geometry.resized(20, 10).shape == (10, 20)


def test_a_misfit_is_also_read_by_its_old_name():
    given = {"name": "pin", "probability": 1.0, "alike": 0.5, "rough_iou": 0.5, "poses": []}
    old = KnownObjectRecord.model_validate({**given, "shortfall_nats": 2.5})
    assert old == KnownObjectRecord.model_validate({**given, "misfit_nats": 2.5})
    assert old.model_dump()["misfit_nats"] == 2.5
