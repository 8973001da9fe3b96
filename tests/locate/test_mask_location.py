"""Location by the outline of contact, with touches from another renderer."""

from dataclasses import replace

import numpy as np
import pytest
from locate_helpers import draw_examples, list_poses, locate_together

from tactile_loc import Localizer, Touch
from tactile_loc.core.poses.tolerance import measure_shape_distances
from tactile_loc.locate.hypotheses import compute_nats
from tactile_loc.locate.result.verdict import Outcome, Verdict
from tactile_loc.locate.sources.place_search import list_presses, spread_anchors
from tactile_loc.plugin import ConfigError, TouchError

SENSOR = {"name": "gelsight-mini", "gel": "rigid", "image_size_px": [160, 120]}


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    return Localizer.create("pin", store=store, sensor=SENSOR, temperature=0.05)


def hide_depths(touch: Touch, sensor, known: bool = False) -> Touch:
    """Return what a sensor of contact alone sees of a touch; the press may be known."""
    poses = {"T_sensor_object": touch.T_sensor_object, "T_base_sensor": touch.T_base_sensor}
    press_depth_m = touch.press_depth_m if known else None
    return Touch.from_mask(touch.contact_shape.contact, sensor=sensor, press_depth_m=press_depth_m, **poses)


@pytest.fixture(scope="module")
def examples(localizer) -> list[list[Touch]]:
    """Return masks of three touches of the object at rest, drawn by ray casting, with unknown presses."""
    return [[hide_depths(touch, localizer.sensor) for touch in some] for some in draw_examples(localizer, 31, 5)]


@pytest.mark.slow
def test_three_masks_locate_the_object(localizer, examples):
    off_m = []
    for touches in examples:
        found, truth = locate_together(localizer, touches), touches[0].T_sensor_object
        off_m.append(measure_shape_distances(localizer.object.mesh, list_poses(found), truth).min())
        assert found.verdict is not Verdict.CERTAIN
    assert np.count_nonzero(np.array(off_m) < 1e-3) >= 4


def test_the_true_pose_explains_its_mask(localizer, examples):
    for touch in (touch for touches in examples for touch in touches):
        iou = localizer.scene.match_touch(touch).contact_iou(touch.T_sensor_object, touch)
        assert iou > 0.85
    touch = examples[0][0]
    shown, mask = localizer.scene.show_like(touch.T_sensor_object, touch).contact, touch.contact_shape.contact
    assert np.count_nonzero(shown & mask) > 0.85 * np.count_nonzero(shown | mask), "another contact is drawn"


def test_a_mask_is_located_on_a_listed_grid(store):
    coarse = {"name": "face", "spacing_mm": 8}
    localizer = Localizer.create("pin", store=store, sensor=SENSOR, grid=coarse, temperature=0.05)
    found = localizer.localize(hide_depths(localizer.simulate(1, seed=3)[0], localizer.sensor))
    assert found.verdict is not Verdict.CERTAIN
    assert found.best.imprint_iou > 0.7


def test_no_coverage_is_promised_for_a_mask_and_an_encoder_trained_on_depths_refuses_it(localizer, examples, store):
    with pytest.raises(ConfigError):
        localizer.localize(examples[0][0], coverage=0.9)
    trained = Localizer.create("pin", store=store, sensor=SENSOR, encoder="moco")
    with pytest.raises(TouchError, match="pixel"):
        trained.localize(examples[0][0])


def test_an_outline_is_never_certain(localizer, examples):
    found = localizer.localize(examples[0][0])
    assert not found.depths_known
    assert replace(found, outcome=Outcome(0.99, 0.01, 0.0)).verdict is not Verdict.CERTAIN


def test_a_mask_counts_as_less_than_a_touch(localizer, examples):
    full, half = (np.ptp(compute_nats(np.array([0.9, 0.8]), count)) for count in (1.0, 0.5))
    assert half < full


def test_an_unknown_press_is_tried_lighter_and_deeper(localizer, examples):
    touch = examples[0][0]
    presses_m = [one.press_depth_m for one in list_presses(touch)]
    assert len(presses_m) == 3
    assert presses_m[0] < touch.press_depth_m < presses_m[2]
    known = replace(touch.contact_shape, indentation_std_m=0.01 * touch.press_depth_m)
    assert len(list_presses(replace(touch, contact_shape=known))) == 1


def test_anchors_are_spread_over_the_mask(examples):
    points = spread_anchors(examples[0][0], 5)
    assert 2 <= len(points) <= 5
    apart_m = np.linalg.norm(points[:, None] - points[None], axis=-1)[np.triu_indices(len(points), 1)]
    assert apart_m.min() > 5e-4
