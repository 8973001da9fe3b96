"""STEP files give triangles in metres, near the exact surface, whatever unit they state."""

import logging
import shutil
import tempfile
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import MissingLibraryError, ObjectError
from tactile_loc.io.meshes.mesh_files import load_object, read_surface
from tactile_loc.io.meshes.step_files import DEVIATION_MM
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.store.store import StageStore

pytest.importorskip("cascadio")

SHAPES = Path(__file__).parent / "step"  # a box of 30 x 20 x 10 mm, and a rod of 8 mm radius, in several units
BOX = SHAPES / "box-mm.step"


@pytest.fixture
def temporary(tmp_path, monkeypatch) -> Path:
    """The folder of temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.mark.parametrize("unit", ["mm", "m", "inch"])
def test_a_box_has_its_size_in_metres(temporary, unit):
    box = load_object(SHAPES / f"box-{unit}.step", symmetry="none")
    np.testing.assert_allclose(box.mesh.extents_m, [0.03, 0.02, 0.01], atol=1e-7)
    assert box.notes == ()  # neither a guessed unit nor an open surface
    assert len(box.mesh.faces) == 12
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_the_triangles_of_a_cylinder_are_near_its_surface(unit):
    radius_m, surface = 0.008, read_surface(SHAPES / f"rod-{unit}.stp")
    assert surface.is_watertight
    rim = surface.vertices[surface.vertices[:, 2] < 1e-6, :2]
    np.testing.assert_allclose(np.linalg.norm(rim, axis=1), radius_m, atol=1e-8)
    angles = np.sort(np.arctan2(*rim.T))
    largest = np.diff(np.append(angles, angles[0] + 2 * np.pi)).max()
    assert 0 < radius_m * (1 - np.cos(largest / 2)) <= 1e-3 * DEVIATION_MM


def test_a_given_unit_is_not_used_and_the_user_is_told(caplog):
    with caplog.at_level(logging.WARNING, "tactile_loc"):
        box = load_object(BOX, "m", "none")
    assert box.mesh.extents_m.max() == pytest.approx(0.03)
    assert any("box-mm.step" in record.message for record in caplog.records)


@pytest.mark.parametrize("keep", [0, 30, 2500])
def test_a_damaged_file_is_refused_in_one_sentence(tmp_path, temporary, capfd, keep):
    path = tmp_path / "box.step"
    path.write_text(BOX.read_text()[:keep])
    with pytest.raises(ObjectError, match=naming("box.step", "STEP")):
        read_surface(path)
    assert capfd.readouterr() == ("", "")
    assert list(temporary.iterdir()) == []


def test_a_missing_library_is_named_with_its_install_line(monkeypatch):
    def miss(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", miss)
    with pytest.raises(MissingLibraryError, match=naming("pip install 'tactile-loc[step]'")):
        read_surface(BOX)


def test_a_stored_file_is_not_converted_again(tmp_path, monkeypatch):
    own_store = StageStore(tmp_path / "store")
    path = shutil.copy(BOX, tmp_path / "box.step")
    first = load_stored_object(path, "auto", "none", own_store)
    monkeypatch.setattr("tactile_loc.io.meshes.step_files.CONVERT", "raise SystemExit(1)")
    again = load_stored_object(path, "auto", "none", own_store)
    assert again.mesh.digest == first.mesh.digest
