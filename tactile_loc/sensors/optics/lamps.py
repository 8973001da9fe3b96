"""The optics of a sensor (coloured lamps, the unpressed gel's curvature, the camera), and the optics of known makes.

Angles and directions refer to the image: x right, y down, and elevation from the sensing surface towards the camera.
The field's radius is half the sensing rectangle's diagonal. Lengths on the surface are in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tactile_loc.core.runtime.errors import ConfigError, advise_choice

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """A distant coloured lamp.

    `direction` (3,) points from the middle of the surface to the lamp: x right, y down, z to the camera. `colour` (3,)
    is the lamp's red, green and blue as the camera records them. `strength` is the brightness, as a share of full
    white, of a surface that faces the lamp.
    """

    direction: tuple[float, float, float]
    colour: Colour
    strength: float

    @classmethod
    def at(cls, azimuth_rad: float, elevation_rad: float, colour: Colour, strength: float) -> Light:
        """Return the light with an azimuth, from image right towards image down, and an elevation, both in radians."""
        flat = math.cos(elevation_rad)
        direction = (flat * math.cos(azimuth_rad), flat * math.sin(azimuth_rad), math.sin(elevation_rad))
        return cls(direction, colour, strength)


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

    lights: tuple[Light, ...]
    ambient: Colour = (0.0, 0.0, 0.0)
    dome: float = 0.0
    specular: float = 0.0
    shininess: float = 20.0
    vignetting: float = 0.0
    blur_m: float = 0.0
    read_noise: float = 0.0
    shot_noise: float = 0.0

    def remove_noise(self) -> Optics:
        """Return the same optics without the camera's noise."""
        return replace(self, read_noise=0.0, shot_noise=0.0)


def _arrange(*lamps: tuple[float, float, float, Colour]) -> tuple[Light, ...]:
    """Return the lights of `lamps`, each (azimuth, elevation, strength, colour), angles in degrees."""
    return tuple(Light.at(math.radians(a), math.radians(e), c, s) for a, e, s, c in lamps)


GENERIC = "gelslim"
OPTICS = {  # matched to photos of balls pressed into one sensor of each make; other sensors differ
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
