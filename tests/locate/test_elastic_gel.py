"""Locating with an elastic gel: touches that another program has drawn are located."""

import dataclasses

import numpy as np
import pytest
from locate_helpers import list_poses, locate_together, measure_errors_mm

from tactile_loc import ContactShape, Localizer, Touch
from tactile_loc.plugin.helpers import invert

MM = 1e3
PRESS_M, THICKNESS_MM = 6e-4, 4.0
ELASTIC = {"name": "gelsight-mini", "gel": "layer", "gel_thickness_mm": THICKNESS_MM, "image_size_px": [160, 120]}
RIGID = {"name": "gelsight-mini", "image_size_px": [160, 120]}


def press_with_contact_mechanics(localizer: Localizer, T: np.ndarray) -> Touch:
    """The touch of a pressed object at T (4, 4), drawn by ContactMechanics at every pixel."""
    mechanics = pytest.importorskip("ContactMechanics")
    systems = pytest.importorskip("ContactMechanics.Systems")
    topography = pytest.importorskip("SurfaceTopography").Topography
    scene = localizer.scene.press(PRESS_M)
    geometry = scene.geometry
    rigid = scene.render_contact_depths(T[None])[0]
    height, width = geometry.shape
    sides_mm = (2 * height / geometry.fy * MM, 2 * width / geometry.fx * MM)
    substrate = mechanics.PeriodicFFTElasticHalfSpace(
        (2 * height, 2 * width), 1.0, sides_mm, thickness=THICKNESS_MM, poisson=geometry.gel.poisson
    )
    heights_mm = np.full((2 * height, 2 * width), -50.0)
    heights_mm[:height, :width] = np.where(rigid < PRESS_M, (PRESS_M - rigid) * MM, -50.0)
    system = systems.NonSmoothContactSystem(substrate, topography(heights_mm, sides_mm))
    assert system.minimize_proxy(offset=0.0, pentol=1e-4, maxiter=500).success
    depth = np.clip(PRESS_M - system.disp[:height, :width] / MM, 0, PRESS_M).astype(np.float32)
    return Touch(ContactShape(depth, PRESS_M), geometry, "elastic", T_base_sensor=invert(T), T_sensor_object=T)


@pytest.fixture(scope="module")
def localizers(store) -> dict[str, Localizer]:
    made = {"elastic": ELASTIC, "rigid": RIGID}
    return {
        name: Localizer.create("hook", store=store, sensor=sensor, temperature=0.05) for name, sensor in made.items()
    }


@pytest.fixture(scope="module")
def touches(localizers) -> list[Touch]:
    drawn = localizers["rigid"].simulate(6, seed=4, press_depth_m=PRESS_M)
    return [press_with_contact_mechanics(localizers["elastic"], np.asarray(t.T_sensor_object)) for t in drawn]


def test_the_true_pose_explains_what_the_gel_shows(localizers, touches):
    """With a rigid gel it does not."""
    elastic, rigid = localizers["elastic"].scene, localizers["rigid"].scene
    for touch in touches:
        T = np.asarray(touch.T_sensor_object)[None]
        as_rigid = dataclasses.replace(touch, geometry=dataclasses.replace(touch.geometry, gel=rigid.geometry.gel))
        assert elastic.match_touch(touch).imprint_ious(T, touch)[0] > 0.9
        assert rigid.match_touch(as_rigid).imprint_ious(T, as_rigid)[0] < 0.75


@pytest.mark.slow
def test_three_touches_locate_the_object(localizers, touches):
    elastic = localizers["elastic"]
    for first in (0, 3):
        some = touches[first : first + 3]
        found = locate_together(elastic, some, top=3)
        assert measure_errors_mm(elastic, list_poses(found), some[0]).min() < 0.2


def test_simulated_touches_are_elastic(localizers):
    elastic, rigid = (localizers[name].simulate(1, seed=1, press_depth_m=PRESS_M)[0] for name in ("elastic", "rigid"))
    np.testing.assert_array_equal(elastic.T_sensor_object, rigid.T_sensor_object)
    assert np.count_nonzero(elastic.contact_shape.contact) > 1.5 * np.count_nonzero(rigid.contact_shape.contact)
    (drawn,) = [press_with_contact_mechanics(localizers["elastic"], np.asarray(elastic.T_sensor_object))]
    off_m = np.abs(drawn.contact_shape.depth_m - elastic.contact_shape.depth_m)
    assert np.sqrt(np.mean(off_m**2)) < 0.02 * PRESS_M
