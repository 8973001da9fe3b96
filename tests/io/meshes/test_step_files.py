"""STEP files give triangles in metres, near the exact surface, whatever unit they state."""

from __future__ import annotations

import logging
import tempfile
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from step_shapes import write_step_box, write_step_cylinder

from tactile_loc.core.runtime.errors import MissingLibraryError, ObjectError
from tactile_loc.io.meshes.mesh_files import load_object, read_surface
from tactile_loc.io.meshes.step_files import DEVIATION_MM
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.store.store import StageStore

UNITS_M = {"mm": 1e-3, "m": 1.0, "inch": 0.0254}


@pytest.fixture
def temporary(tmp_path, monkeypatch) -> Path:
    """The folder of temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.mark.parametrize("unit", list(UNITS_M))
def test_a_box_has_its_size_in_metres(tmp_path, temporary, unit):
    size_m = np.array([0.03, 0.02, 0.01])
    path = write_step_box(tmp_path / "box.step", *(size_m / UNITS_M[unit]), unit=unit)
    box = load_object(path, symmetry="none")
    np.testing.assert_allclose(box.mesh.extents_m, size_m, atol=1e-7)
    assert box.notes == ()  # neither a guessed unit nor an open surface
    assert len(box.mesh.faces) == 12
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("unit", ["mm", "m"])
def test_the_triangles_of_a_cylinder_are_near_its_surface(tmp_path, unit):
    radius_m = 0.008
    path = write_step_cylinder(tmp_path / "rod.stp", radius_m / UNITS_M[unit], 0.02 / UNITS_M[unit], unit)
    surface = read_surface(path)
    assert surface.is_watertight
    rim = surface.vertices[surface.vertices[:, 2] < 1e-6, :2]
    np.testing.assert_allclose(np.linalg.norm(rim, axis=1), radius_m, atol=1e-8)
    angles = np.sort(np.arctan2(*rim.T))
    largest = np.diff(np.append(angles, angles[0] + 2 * np.pi)).max()
    assert 0 < radius_m * (1 - np.cos(largest / 2)) <= 1e-3 * DEVIATION_MM


def test_a_given_unit_is_not_used_and_the_user_is_told(tmp_path, caplog):
    path = write_step_box(tmp_path / "box.step", 30, 20, 10)
    with caplog.at_level(logging.WARNING, "tactile_loc"):
        box = load_object(path, "m", "none")
    assert box.mesh.extents_m.max() == pytest.approx(0.03)
    assert any("box.step" in record.message for record in caplog.records)


@pytest.mark.parametrize("keep", [0, 30, 2500])
def test_a_damaged_file_is_refused_in_one_sentence(tmp_path, temporary, capfd, keep):
    path = write_step_box(tmp_path / "box.step", 30, 20, 10)
    path.write_text(path.read_text()[:keep])
    with pytest.raises(ObjectError, match=naming("box.step", "STEP")):
        read_surface(path)
    assert capfd.readouterr() == ("", "")
    assert list(temporary.iterdir()) == []


def test_a_missing_library_is_named_with_its_install_line(tmp_path, monkeypatch):
    def miss(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    path = write_step_box(tmp_path / "box.step", 30, 20, 10)
    monkeypatch.setattr(metadata, "version", miss)
    with pytest.raises(MissingLibraryError, match=naming("pip install 'tactile-loc[step]'")):
        read_surface(path)


def test_a_stored_file_is_not_converted_again(tmp_path, monkeypatch):
    own_store = StageStore(tmp_path / "store")
    path = write_step_box(tmp_path / "box.step", 30, 20, 10)
    first = load_stored_object(path, "auto", "none", own_store)
    monkeypatch.setattr("tactile_loc.io.meshes.step_files.CONVERT", "raise SystemExit(1)")
    again = load_stored_object(path, "auto", "none", own_store)
    assert again.mesh.digest == first.mesh.digest
