"""Write boxes and cylinders as STEP files, without a CAD program, as the text that ISO 10303-21 defines."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

LENGTHS = {"mm": "SI_UNIT(.MILLI.,.METRE.)", "m": "SI_UNIT($,.METRE.)"}
INCH_M = "LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(0.0254),#{})"
HEADER = """\
ISO-10303-21;
HEADER;
FILE_DESCRIPTION((''),'2;1');
FILE_NAME('box','',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));
ENDSEC;
DATA;
"""
PRODUCT = """\
APPLICATION_CONTEXT('design')
APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#1)
PRODUCT_CONTEXT('',#1,'mechanical')
PRODUCT('box','box','',(#3))
PRODUCT_DEFINITION_FORMATION('','',#4)
PRODUCT_DEFINITION_CONTEXT('part definition',#1,'design')
PRODUCT_DEFINITION('design','',#5,#6)
PRODUCT_DEFINITION_SHAPE('','',#7)"""


class _Entities:
    """The numbered entities of a STEP file."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, text: str) -> int:
        """Add an entity, and return its number."""
        self.lines.append(text)
        return len(self.lines)

    def point(self, place: np.ndarray) -> int:
        return self.add("CARTESIAN_POINT('',({}))".format(",".join(f"{v:.6f}" for v in place)))

    def direction(self, vector: np.ndarray) -> int:
        return self.add("DIRECTION('',({}))".format(",".join(f"{v:.6f}" for v in vector)))

    def frame(self, origin: np.ndarray, z: np.ndarray, x: np.ndarray) -> int:
        return self.add(f"AXIS2_PLACEMENT_3D('',#{self.point(origin)},#{self.direction(z)},#{self.direction(x)})")

    def face(self, surface: int, around: list[tuple[int, str]]) -> int:
        """Add a face of a surface, bounded by edges, each with its sense T or F."""
        oriented = [self.add(f"ORIENTED_EDGE('',*,*,#{edge},.{sense}.)") for edge, sense in around]
        loop = self.add("EDGE_LOOP('',({}))".format(",".join(f"#{edge}" for edge in oriented)))
        bound = self.add(f"FACE_OUTER_BOUND('',#{loop},.T.)")
        return self.add(f"ADVANCED_FACE('',(#{bound}),#{surface},.T.)")


def write_step_box(path: Path, x: float, y: float, z: float, unit: str = "mm") -> Path:
    """Write a box from the origin to (x, y, z), in `unit`: m, mm or inch."""
    made = _make_product()
    corners = [np.array(c) * (x, y, z) for c in itertools.product((0.0, 1.0), repeat=3)]
    vertices = [made.add(f"VERTEX_POINT('',#{made.point(corner)})") for corner in corners]
    edges: dict[tuple[int, int], int] = {}
    for a, b in itertools.combinations(range(8), 2):
        if bin(a ^ b).count("1") == 1:
            along = corners[b] - corners[a]
            vector = made.add(f"VECTOR('',#{made.direction(along / np.linalg.norm(along))},1.)")
            line = made.add(f"LINE('',#{made.point(corners[a])},#{vector})")
            edges[a, b] = made.add(f"EDGE_CURVE('',#{vertices[a]},#{vertices[b]},#{line},.T.)")
    faces = [_add_face(made, corners, edges, axis, side) for axis in range(3) for side in (0, 1)]
    return _write_solid(path, made, faces, unit)


def write_step_cylinder(path: Path, radius: float, height: float, unit: str = "mm") -> Path:
    """Write a cylinder about z, from z = 0 to `height`, in `unit`: m, mm or inch."""
    made = _make_product()
    x, z = np.eye(3)[0], np.eye(3)[2]
    frames = [made.frame(level * z, z, x) for level in (0.0, height)]
    vertices = [made.add(f"VERTEX_POINT('',#{made.point(radius * x + level * z)})") for level in (0.0, height)]
    circles = [made.add(f"CIRCLE('',#{frame},{radius:.6f})") for frame in frames]
    rims = [made.add(f"EDGE_CURVE('',#{v},#{v},#{c},.T.)") for v, c in zip(vertices, circles, strict=True)]
    vector = made.add(f"VECTOR('',#{made.direction(z)},1.)")
    line = made.add(f"LINE('',#{made.point(radius * x)},#{vector})")
    seam = made.add(f"EDGE_CURVE('',#{vertices[0]},#{vertices[1]},#{line},.T.)")
    side = made.add(f"CYLINDRICAL_SURFACE('',#{frames[0]},{radius:.6f})")
    bottom = made.add(f"PLANE('',#{made.frame(0 * z, -z, x)})")
    top = made.add(f"PLANE('',#{frames[1]})")
    faces = [
        made.face(side, [(rims[0], "T"), (seam, "T"), (rims[1], "F"), (seam, "F")]),
        made.face(bottom, [(rims[0], "F")]),
        made.face(top, [(rims[1], "T")]),
    ]
    return _write_solid(path, made, faces, unit)


def _make_product() -> _Entities:
    """Return the entities of a part without a shape."""
    made = _Entities()
    for line in PRODUCT.splitlines():
        made.add(line)
    return made


def _write_solid(path: Path, made: _Entities, faces: list[int], unit: str) -> Path:
    """Write a solid with the given faces."""
    shell = made.add("CLOSED_SHELL('',({}))".format(",".join(f"#{face}" for face in faces)))
    brep = made.add(f"MANIFOLD_SOLID_BREP('box',#{shell})")
    origin = made.frame(np.zeros(3), np.eye(3)[2], np.eye(3)[0])
    context = _add_context(made, unit)
    shape = made.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',(#{origin},#{brep}),#{context})")
    made.add(f"SHAPE_DEFINITION_REPRESENTATION(#8,#{shape})")
    body = "".join(f"#{k}={line};\n" for k, line in enumerate(made.lines, 1))
    path.write_text(f"{HEADER}{body}ENDSEC;\nEND-ISO-10303-21;\n")
    return path


def _add_face(
    made: _Entities, corners: list[np.ndarray], edges: dict[tuple[int, int], int], axis: int, side: int
) -> int:
    """Add the face whose outward normal is + or - `axis`."""
    u, v = (4 >> (axis + 1) % 3, 4 >> (axis + 2) % 3)  # the bits of the two axes along the face
    first = side * (4 >> axis)
    ring = [first, first + u, first + u + v, first + v]
    ring = ring if side else ring[::-1]  # counter-clockwise, seen from outside
    pairs = zip(ring, ring[1:] + ring[:1], strict=True)
    around = [(edges[a, b], "T") if (a, b) in edges else (edges[b, a], "F") for a, b in pairs]
    normal = np.eye(3)[axis] * (1 if side else -1)
    plane = made.add(f"PLANE('',#{made.frame(corners[first], normal, np.eye(3)[(axis + 1) % 3])})")
    return made.face(plane, around)


def _add_context(made: _Entities, unit: str) -> int:
    """Add the units, and return the number of the context that names them."""
    if unit in LENGTHS:
        length = made.add(f"(LENGTH_UNIT()NAMED_UNIT(*){LENGTHS[unit]})")
    else:
        metre = made.add(f"(LENGTH_UNIT()NAMED_UNIT(*){LENGTHS['m']})")
        measure = made.add(INCH_M.format(metre))
        exponents = made.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
        length = made.add(f"(CONVERSION_BASED_UNIT('INCH',#{measure})LENGTH_UNIT()NAMED_UNIT(#{exponents}))")
    angle = made.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid = made.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    exact = made.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),#{length},'accuracy','')")
    return made.add(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{exact}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length},#{angle},#{solid}))REPRESENTATION_CONTEXT('',''))"
    )
