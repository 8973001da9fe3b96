"""A long block that is nearly the same after half a turn, and a study of it with presses but without touches."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from tactile_loc import Localizer, TriangleMesh
from tactile_loc.plugin import ObjectModel
from tactile_loc.plugin.helpers import SymmetryGroup

from tactile_loc_touchability.locating import NOTHING
from tactile_loc_touchability.presses import PressingSensor, draw_presses
from tactile_loc_touchability.study import Study, StudyOptions

PRESS_M = 6e-4


def make_object(name: str, made: trimesh.Trimesh) -> ObjectModel:
    mesh = TriangleMesh(1e-3 * np.asarray(made.vertices), np.asarray(made.faces, np.int64))
    return ObjectModel(name, mesh, SymmetryGroup(np.zeros(3)))


@pytest.fixture(scope="session")
def plain() -> ObjectModel:
    """A block of 30 x 12 x 8 mm, whose symmetry is not declared."""
    return make_object("plain", trimesh.creation.box((30, 12, 8)))


@pytest.fixture(scope="session")
def notched() -> ObjectModel:
    """The same block with a notch of 3 x 12 x 1.5 mm across the top, near its end at +x."""
    notch = trimesh.creation.box((3, 14, 3)).apply_translation([11, 0, 4])
    return make_object("notched", trimesh.boolean.difference([trimesh.creation.box((30, 12, 8)), notch], "manifold"))


@pytest.fixture(scope="session")
def localizer(tmp_path_factory: pytest.TempPathFactory) -> Localizer:
    """A localizer of the demo object pin, whose store is in a temporary folder."""
    grid = {"name": "whole", "directions": 300}
    store = tmp_path_factory.mktemp("touchability") / "store"
    return Localizer.create("pin", sensor="gelsight-mini", grid=grid, store=store)


def make_study(localizer: Localizer, obj: ObjectModel, count: int = 60) -> Study:
    """Return a study of an object with presses, whose touches fit no pose."""
    found = Localizer(localizer.config, obj, localizer.store)
    rng = np.random.default_rng(2)
    presses = draw_presses(obj, PressingSensor(found.scene.geometry, PRESS_M, np.radians(20.0)), count, rng)
    row = {"verdict": NOTHING, "error_m": None, "right": 0.0, "freedom": "", "rivals": []}
    return Study(found, PRESS_M, StudyOptions(count, 0), presses, [row] * count, {})


@pytest.fixture(scope="session")
def study_of(localizer: Localizer, plain: ObjectModel, notched: ObjectModel) -> dict[str, Study]:
    """Studies of the plain and of the notched block, by name."""
    return {obj.name: make_study(localizer, obj) for obj in (plain, notched)}


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")
