"""Small demo objects, so that everything can be tried without a CAD file of one's own.

The meshes are watertight, in metres, made by `scripts/demo_meshes.py`, whose functions describe each one's frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

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


_ROWS = (
    ("pin", "z2", "stepped locating pin: grooved shank with a cross hole, head with two flats (31 mm)"),
    ("damping_pin", "zinf", "damping pin: barbed stem, round flange, bulbous end (39 mm)"),
    ("head", "z2", "slotted bolt head: hexagon on a washer flange, dome, short shaft (24 mm, 28 mm wide)"),
    ("elbow_pipe", "x2", "hollow 90 degree pipe elbow, flanged and beaded at both ends (68 mm)"),
    ("cotter", "none", "split cotter pin: round eye, two half-round legs of unequal length (64 mm)"),
    ("hook", "none", "J hook: ring-grooved shank, hexagonal collar, round wire (77 mm)"),
)
DEMO_OBJECTS: Mapping[str, DemoObject] = MappingProxyType(
    {name: DemoObject(name, _FOLDER / f"{name}.ply", about, symmetry) for name, symmetry, about in _ROWS}
)
