"""The optics of a sensor (coloured lamps, the unpressed gel's curvature, the camera), and the optics of known makes.

Angles and directions refer to the image: x right, y down, and elevation from the sensing surface towards the camera.
The field's radius is half the sensing rectangle's diagonal. Lengths on the surface are in metres. Impossible values
raise pydantic's ValidationError.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from tactile_loc.core.runtime.errors import ConfigError, advise_choice

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Colour = tuple[Share, Share, Share]


@dataclass(frozen=True)
class Light:
    """A distant coloured lamp.

    `direction` (3,) points from the middle of the surface to the lamp: x right, y down, z to the camera. `colour` (3,)
    is the lamp's red, green and blue as the camera records them. `strength` is the brightness, as a share of full
    white, of a surface that faces the lamp.
    """

    direction: tuple[Finite, Finite, Positive]
    colour: Colour
    strength: Share

    @classmethod
    def at(cls, azimuth_rad: float, elevation_rad: float, colour: Colour, strength: float) -> Light:
        """Return the light with an azimuth, from image right towards image down, and an elevation, both in radians."""
        flat = math.cos(elevation_rad)
        direction = (flat * math.cos(azimuth_rad), flat * math.sin(azimuth_rad), math.sin(elevation_rad))
        return cls(direction, colour, strength)

    @property
    def azimuth_rad(self) -> float:
        """The azimuth of the light in the image, radians: 0 is right, pi/2 is below."""
        return math.atan2(self.direction[1], self.direction[0])

    @property
    def elevation_rad(self) -> float:
        """The elevation of the light above the sensing surface, 0 to pi/2 radians."""
        return math.atan2(self.direction[2], math.hypot(*self.direction[:2]))

    def vary(self, rng: np.random.Generator, strength: float) -> Light:
        """Return a random variant of the light; `strength` 1 (unitless) is the usual spread between sensors."""
        up, *colour, turned, brighter, _ = strength * rng.normal(size=7)  # seven, as when lamps had a distance
        elevation = self.elevation_rad + math.radians(3) * up
        red, green, blue = (c * math.exp(0.1 * spread) for c, spread in zip(self.colour, colour, strict=True))
        return Light.at(
            self.azimuth_rad + math.radians(6) * turned,
            min(max(elevation, math.radians(5)), math.radians(89)),
            (red, green, blue),
            self.strength * math.exp(0.15 * brighter),
        )


@dataclass(frozen=True)
class Optics:
    """The optics of a sensor. Brightness is a share of full white (255 counts).

    `ambient` (3,) is light from all directions. `dome` is the unpressed gel's slope at the field's radius, unitless. It
    is positive if the gel bulges towards the object. `specular` and `shininess` describe the coating's gloss, after
    Blinn and Phong: the reflected share of each light, and the exponent. `vignetting` is the share of light lost at the
    field's radius. `blur_m` is the standard deviation of the lens's blur on the surface, metres. `read_noise` is the
    standard deviation of every pixel's noise, 8-bit counts. `shot_noise` is that of the additional noise of a full
    white pixel.
    """

    lights: Annotated[tuple[Light, ...], Field(min_length=1)]
    ambient: Colour = (0.0, 0.0, 0.0)
    dome: Finite = 0.0
    specular: Share = 0.0
    shininess: Share = 20.0
    vignetting: Annotated[float, Field(ge=0, le=1)] = 0.0
    blur_m: Share = 0.0
    read_noise: Share = 0.0
    shot_noise: Share = 0.0

    def describe(self) -> dict[str, Any]:
        """Return the settings as JSON values that identify the optics."""
        described: dict[str, Any] = TypeAdapter(Optics).dump_python(self, mode="json")
        return described

    @classmethod
    def parse(cls, described: Mapping[str, Any]) -> Optics:
        """Return optics from the values of `describe`. Raises ValidationError for other values."""
        return TypeAdapter(cls).validate_python(described)

    def remove_noise(self) -> Optics:
        """Return the same optics without the camera's noise."""
        return replace(self, read_noise=0.0, shot_noise=0.0)

    def vary(self, rng: np.random.Generator, strength: float = 1.0) -> Optics:
        """Return random optics, as another sensor of this make may have: lights, exposure, dome, blur and noise differ.

        `strength` (unitless) scales the spread: 0 gives the same optics, 1 the usual spread.
        """
        if strength == 0:
            return self

        def scaled(value: float, spread: float) -> float:
            return value * math.exp(spread * strength * rng.normal())

        exposure = scaled(1.0, 0.1)
        lights = tuple(light.vary(rng, strength) for light in self.lights)
        red, green, blue = (exposure * scaled(a, 0.2) for a in self.ambient)
        return replace(
            self,
            lights=tuple(replace(light, strength=exposure * light.strength) for light in lights),
            ambient=(red, green, blue),
            dome=scaled(self.dome, 0.3),
            specular=scaled(self.specular, 0.2),
            vignetting=min(1.0, scaled(self.vignetting, 0.2)),
            blur_m=scaled(self.blur_m, 0.2),
            read_noise=scaled(self.read_noise, 0.2),
            shot_noise=scaled(self.shot_noise, 0.2),
        )


def _arrange(*lamps: tuple[float, float, float, Colour]) -> tuple[Light, ...]:
    """Return the lights of `lamps`, each (azimuth, elevation, strength, colour), angles in degrees."""
    return tuple(Light.at(math.radians(a), math.radians(e), c, s) for a, e, s, c in lamps)


GENERIC = "gelslim"
OPTICS = {  # matched to photos of balls pressed into one sensor of each make; other sensors differ: see `Optics.vary`
    "gelslim": Optics(
        _arrange((-29, 23, 1.4, (1.0, 0.0, 0.0)), (117, 22, 0.6, (0.0, 1.0, 0.15)), (205, 28, 1.2, (0.0, 0.1, 1.0))),
        ambient=(0.03, 0.35, 0.03),
        dome=0.3,
        vignetting=0.35,
        blur_m=4e-5,
        read_noise=1.0,
        shot_noise=2.0,
    ),
    "gelsight-mini": Optics(
        _arrange((-100, 25, 0.55, (1.0, 0.0, 0.15)), (0, 30, 0.5, (0.05, 1.0, 0.2)), (125, 30, 0.5, (0.0, 0.25, 1.0))),
        ambient=(0.16, 0.2, 0.24),
        dome=0.35,
        vignetting=0.35,
        blur_m=6e-5,
        read_noise=1.0,
        shot_noise=2.0,
    ),
    "digit": Optics(
        _arrange((-30, 25, 0.8, (1.0, 0.1, 0.1)), (200, 25, 0.8, (0.05, 1.0, 0.05)), (90, 25, 0.65, (0.0, 0.1, 1.0))),
        ambient=(0.12, 0.08, 0.1),
        dome=0.35,
        specular=0.1,
        vignetting=0.4,
        blur_m=8e-5,
        read_noise=1.5,
        shot_noise=2.0,
    ),
}


def choose_optics(sensor: str, name: str | None = None) -> Optics:
    """Return the optics called `name`: gelslim, gelsight-mini or digit. Raises ConfigError for another name.

    By default, return those of a named sensor, or generic optics for another sensor.
    """
    if name is None:
        return OPTICS.get(sensor, OPTICS[GENERIC])
    if name not in OPTICS:
        raise ConfigError(f"there are no optics {name!r}; {advise_choice(name, OPTICS)}")
    return OPTICS[name]
