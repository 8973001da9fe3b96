"""Image health: the measures of synthetic images, and the limits for warnings and errors."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from message_helpers import missing, naming
from press_sets import sensor

from tactile_loc.core.runtime.errors import TouchError, note_source
from tactile_loc.sensors.reading.reading import Health, find_worst, measure_health, require_healthy

GEOMETRY = sensor(64)
UNTOUCHED = np.full((*GEOMETRY.shape, 3), 100, np.uint8)
USUAL = Health(light=4.0, unfit=0.2)


def bump() -> np.ndarray:
    """The slopes (H, W, 2) of a smooth hill; the steepest is 0.6."""
    x = np.linspace(-3, 3, 64)
    hill = np.exp(-(x[:, None] ** 2) - x[None] ** 2)
    down, across = np.gradient(hill)
    slopes = np.stack([across, down], axis=-1)
    return (0.6 * slopes / np.abs(slopes).max()).astype(np.float32)


def test_slopes_with_curl_fit_no_surface_and_shallow_slopes_give_no_measure():
    whirl = np.stack([-bump()[..., 1], bump()[..., 0]], axis=-1)
    assert measure_health(UNTOUCHED, UNTOUCHED, bump(), GEOMETRY).unfit < 0.05
    assert measure_health(UNTOUCHED, UNTOUCHED, whirl, GEOMETRY).unfit == pytest.approx(1.0, abs=0.05)
    for shallow in (None, 0.1 * bump()):
        assert np.isnan(measure_health(UNTOUCHED, UNTOUCHED, shallow, GEOMETRY).unfit)


def test_the_light_is_the_median_change_of_the_image():
    image = UNTOUCHED.copy()
    image[:20] += 90  # a press that covers less than half of the image
    assert measure_health(image, UNTOUCHED, None, GEOMETRY).light < 1.0
    image = UNTOUCHED.copy()
    image[..., 2] += 12
    assert measure_health(image, UNTOUCHED, None, GEOMETRY).light == pytest.approx(12.0)


def test_the_health_ratio_is_the_worse_of_both_measures():
    assert Health(8.0, 0.2).compare(USUAL) == pytest.approx(2.0)
    assert Health(4.0, 0.6).compare(USUAL) == pytest.approx(3.0)
    assert Health(4.0, np.nan).compare(USUAL) == pytest.approx(1.0)
    assert Health(8.0, 0.9).compare(Health(4.0, np.nan)) == pytest.approx(9.0)  # calibration without steep slopes


def test_the_worst_health_is_found_and_recorded():
    found = find_worst([Health(1.0, np.nan), Health(3.0, 0.2), Health(2.0, 0.1)])
    assert found == Health(3.0, 0.2)
    assert Health.of_record(found.record()) == found
    unknown = find_worst([Health(1.0, np.nan)])
    assert unknown.record() == {"light": 1.0, "unfit": None}
    assert np.isnan(Health.of_record(unknown.record()).unfit)


def test_poor_health_warns_and_worse_health_is_refused(caplog):
    with caplog.at_level(logging.WARNING):
        require_healthy(Health(4.0, 0.25), USUAL)
        assert not caplog.records
        with note_source("photos/a.png"):
            require_healthy(Health(8.0, 0.2), USUAL)
    assert caplog.messages[0].startswith("photos/a.png: ")
    (record,) = caplog.records
    assert not missing(record.message, 2.0, "light")
    with pytest.raises(TouchError, match=naming(3.0, "surface", "`zero`")):
        require_healthy(Health(4.0, 0.6), USUAL)
