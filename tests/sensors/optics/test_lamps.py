"""Descriptions of lights and cameras: refused values, identity, and variation."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from imaging_helpers import lamp, lit, rng
from message_helpers import naming
from pydantic import ValidationError

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.sensors.optics.lamps import OPTICS, Light, Optics, choose_optics


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.3, 0.2), (-2.5, 1.2), (math.pi / 2, 0.7)])
def test_a_light_has_the_direction_of_its_angles(azimuth, elevation):
    light = Light.at(azimuth, elevation, (1.0, 1.0, 1.0), 1.0)
    assert light.azimuth_rad == pytest.approx(azimuth)
    assert light.elevation_rad == pytest.approx(elevation)
    assert np.linalg.norm(light.direction) == pytest.approx(1.0)


BAD = {
    "direction": [(1.0, 0.0, 0.0), (1.0, 0.0, -0.2), (1.0, math.nan, 1.0), (1.0, 0.0)],
    "colour": [(1.0, -0.1, 0.0), (1.0, 1.0)],
    "strength": [-1.0, math.inf],
    "lights": [()],
    "ambient": [(0.1, 0.1, -0.1)],
    "dome": [math.nan],
    "vignetting": [1.5],
    "blur_m": [-1e-5],
    "shot_noise": [math.inf],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in BAD.items() for value in values])
def test_impossible_lights_and_optics_are_refused(name, value):
    with pytest.raises(ValidationError, match=name):
        replace(lamp() if hasattr(lamp(), name) else lit("right"), **{name: value})


def test_optics_are_described_as_json():
    domed = Optics((lamp(), lamp("left")), dome=0.2)
    described = domed.describe()
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert Optics.parse(described) == domed
    older = [{**light, "distance": None} for light in described["lights"]]  # lamps had distances once
    assert Optics.parse({**described, "lights": older}) == domed
    descriptions = [json.dumps(o.describe()) for o in (domed, domed.remove_noise(), lit("right"), *OPTICS.values())]
    assert len(set(descriptions)) == len(descriptions) - 1  # `domed` has no noise to lose


@pytest.mark.parametrize("name", list(OPTICS))
def test_specimens_vary_around_their_sensor_model(name):
    make = OPTICS[name]
    assert make.vary(rng(), 0.0) == make
    assert make.vary(rng(3)) == make.vary(rng(3))
    assert make.vary(rng(3)) != make.vary(rng(4))
    generator = rng()
    specimens = [make.vary(generator) for _ in range(400)]
    strengths = np.array([[light.strength for light in o.lights] for o in specimens])
    made = np.array([light.strength for light in make.lights])
    assert np.median(strengths, axis=0) == pytest.approx(made, rel=0.05)
    spread = np.log(strengths / made).std(axis=0)
    assert spread == pytest.approx(math.hypot(0.15, 0.1) * np.ones(3), rel=0.2)  # the lamp and the exposure both vary
    turned = np.array([o.lights[0].azimuth_rad for o in specimens]) - make.lights[0].azimuth_rad
    assert np.degrees(np.angle(np.exp(1j * turned))).std() == pytest.approx(6.0, rel=0.2)
    wild = [make.vary(generator, 5.0) for _ in range(50)]  # no draw puts a light behind the gel
    assert all(light.direction[2] > 0 for o in wild for light in o.lights)


def test_optics_are_those_of_the_name_or_of_the_sensor():
    assert choose_optics("gelslim", "digit") is choose_optics("digit") is OPTICS["digit"]
    assert choose_optics("my_sensor.toml") is OPTICS["gelslim"]
    with pytest.raises(ConfigError, match=naming("'gelslam'", "'gelslim'")):
        choose_optics("digit", "gelslam")
