"""Six small parts as meshes, and a library of them with few directions."""

import shutil
from pathlib import Path

import pytest
import trimesh
from library_helpers import FEW

from tactile_loc_library.building import build_library, list_meshes
from tactile_loc_library.library import Library


@pytest.fixture(scope="session")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of six blocks with a step, of different sizes, mm."""
    folder = tmp_path_factory.mktemp("meshes")
    for k in range(6):
        block = trimesh.creation.box([10 + k, 8, 6])
        step = trimesh.creation.box([4, 4 + 0.3 * k, 3]).apply_translation([1, 1, 4.5])
        trimesh.util.concatenate([block, step]).export(folder / f"part-{k}.stl")
    return folder


@pytest.fixture(scope="session")
def built(meshes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library of the six parts, built part by part in this process. Tests must not change it."""
    path = tmp_path_factory.mktemp("built") / "library"
    build_library(path, list_meshes([meshes], "mm", "none"), FEW)
    return path


@pytest.fixture
def library(built: Path, tmp_path: Path) -> Library:
    """A copy of the library, to change."""
    shutil.copytree(built, tmp_path / "library")
    return Library.open(tmp_path / "library")
