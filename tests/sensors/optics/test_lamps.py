"""Descriptions of lights, and the choice of known optics."""

import math

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.sensors.optics.lamps import OPTICS, Light, choose_optics


def test_a_light_has_the_direction_of_its_angles():
    light = Light.at(math.pi / 2, 0.7, (1.0, 1.0, 1.0), 1.0)
    assert light.direction == pytest.approx((0.0, math.cos(0.7), math.sin(0.7)))
    assert np.linalg.norm(light.direction) == pytest.approx(1.0)


def test_optics_are_those_of_the_name_or_of_the_sensor():
    assert choose_optics("gelslim", "digit") is choose_optics("digit") is OPTICS["digit"]
    assert choose_optics("my_sensor.toml") is OPTICS["gelslim"]
    with pytest.raises(ConfigError, match=naming("'gelslam'", "'gelslim'")):
        choose_optics("digit", "gelslam")
