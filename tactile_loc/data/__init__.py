"""Small demo objects, so that everything can be tried without a CAD file of one's own.

The meshes are watertight, in metres, made by `scripts/demo_meshes.py`, whose dimensions describe each one's frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from tactile_loc.core.errors import ObjectError, did_you_mean

_FOLDER = Path(__file__).parent / "objects"


@dataclass(frozen=True)
class DemoObject:
    """One shipped object.

    `path` is its mesh (binary PLY, metres). `symmetry` declares its rotations onto itself: terms joined with `*`, each
    an axis through the origin and an order (`z2`, `x2`, `zinf`), or `none`.
    """

    name: str
    path: Path
    description: str
    symmetry: str


def _table(*rows: tuple[str, str, str]) -> Mapping[str, DemoObject]:
    objects = {name: DemoObject(name, _FOLDER / f"{name}.ply", about, symmetry) for name, symmetry, about in rows}
    return MappingProxyType(objects)


DEMO_OBJECTS: Mapping[str, DemoObject] = _table(
    ("pin", "z2", "stepped locating pin: grooved shank with a cross hole, head with two flats (31 mm)"),
    ("damping_pin", "zinf", "damping pin: barbed stem, round flange, bulbous end (39 mm)"),
    ("head", "z2", "slotted bolt head: hexagon on a washer flange, dome, short shaft (24 mm, 28 mm wide)"),
    ("elbow_pipe", "x2", "hollow 90 degree pipe elbow, flanged and beaded at both ends (68 mm)"),
    ("cotter", "none", "split cotter pin: round eye, two half-round legs of unequal length (64 mm)"),
    ("hook", "none", "J hook: ring-grooved shank, hexagonal collar, round wire (77 mm)"),
)


def demo_object_path(name: str) -> Path:
    """Return the mesh file (binary PLY, metres) of the demo object called `name`.

    Raises ObjectError if there is no such object.
    """
    if name not in DEMO_OBJECTS:
        known = ", ".join(DEMO_OBJECTS)
        hint = did_you_mean(name, DEMO_OBJECTS)
        raise ObjectError(f"There is no demo object {name!r}; choose one of {known}.{hint}")
    return DEMO_OBJECTS[name].path
