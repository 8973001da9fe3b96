"""Photos of touches: poses are polished sideways, and the likeliest law of the gel is used."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tactile_loc import Hypothesis, Localization, Localizer, Touch
from tactile_loc.core.sensing.gel import RIGID
from tactile_loc.locate.polish import polish
from tactile_loc.plugin import RefinedPose
from tactile_loc.plugin.helpers import make_transform

PRESS_M = 5e-4
PHOTO = np.zeros((4, 4, 3), np.uint8)


@pytest.fixture(scope="module")
def localizer(store, tmp_path_factory) -> Localizer:
    tip = trimesh.creation.box((4.0, 6.0, 10.0))
    mesh = tmp_path_factory.mktemp("tip") / "tip.stl"
    tip.export(mesh)
    sensor = {"name": "gelsight-mini", "image_size_px": [160, 120]}
    return Localizer.create(mesh, units="mm", store=store, sensor=sensor)


@pytest.fixture(scope="module")
def touch(localizer) -> Touch:
    """A touch of the flat tip, as read from a photo."""
    T = make_transform(Rotation.from_euler("z", 20, degrees=True).as_matrix(), [5e-4, -3e-4, 0.05])
    T, _ = localizer.scene.press(PRESS_M).bring_to_contact(T[None])
    shape = localizer.scene.contact_shape(T[0], PRESS_M)
    return Touch(shape, localizer.scene.geometry, "tip", T_sensor_object=T[0], image=PHOTO)


def test_a_flat_tip_is_moved_and_turned_to_its_outline(localizer, touch):
    T_true = np.asarray(touch.T_sensor_object)
    off = make_transform(Rotation.from_euler("z", 2, degrees=True).as_matrix(), [1.5e-4, -1e-4, 0.0])
    one = Hypothesis(1.0, T_true, RefinedPose(off @ T_true, 0.9, True, 1), -1, 1, 0.9)
    (found,) = polish(localizer.make_views([touch]), [one])
    left = found.T_sensor_object @ np.linalg.inv(T_true)
    assert np.abs(left[:2, 3]).max() < 5e-5
    assert np.degrees(Rotation.from_matrix(left[:3, :3]).magnitude()) < 0.7
    assert found.imprint_iou > 0.95


def test_the_likeliest_law_of_the_gel_locates_a_touch(localizer, touch, tmp_path):
    """A wrong reading does not count if the photo has a right one, and the result states the law."""
    shape = touch.contact_shape
    sheared = dataclasses.replace(shape, depth_m=np.where(np.arange(160) % 12 < 6, shape.depth_m, shape.press_depth_m))
    alone = localizer.localize(dataclasses.replace(touch, contact_shape=sheared))
    known = dataclasses.replace(shape, touching=shape.contact)
    both = dataclasses.replace(sheared, otherwise=((RIGID, known),))
    found = localizer.localize(dataclasses.replace(touch, contact_shape=both))
    assert found.best.imprint_iou > alone.best.imprint_iou + 0.1
    assert found.touch.gel_law == "outlined layer"
    assert found.touch.is_reading_of(dataclasses.replace(touch, contact_shape=both))
    assert not found.touch.is_reading_of(touch)
    assert found.measure_errors_m(localizer.object)[0] < 5e-4
    found.save(tmp_path)
    read = Localization.load(tmp_path)
    assert read.to_json()["touch"]["gel_law"] == "outlined layer"
    np.testing.assert_array_equal(read.touch.touching_shape.contact, found.touch.touching_shape.contact)
