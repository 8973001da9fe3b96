"""Small demo objects, for first steps without your own CAD file.

The meshes are watertight and in metres. The functions of `scripts/demo_meshes.py` make the meshes and describe the
objects' frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

_FOLDER = Path(__file__).parent / "objects"


@dataclass(frozen=True)
class DemoObject:
    """A demo object that comes with the package.

    `path` is the file of its mesh (binary PLY, metres). `symmetry` states its rotational symmetry: `none`, or terms
    joined with `*`. A term is an axis through the origin and an order, such as `z2`, `x2` or `zinf`.
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
