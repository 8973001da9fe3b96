"""Draw the parts of the benchmark's split `held-out`: `python scripts/benchmark_parts.py FOLDER` writes them all.

Nothing in tactile-loc was tuned on these parts. They are drawn in millimetres with manifold3d, as the demo objects are.
The same code and libraries give the same bytes.
"""

import argparse
from pathlib import Path

import demo_meshes
import numpy as np
from demo_meshes import FAR, revolved
from manifold3d import CrossSection, FillRule, Manifold

SIDES = 32  # of round holes and bosses


def box(x: float, y: float, z: float, at: tuple[float, float, float] = (0, 0, 0)) -> Manifold:
    """Return a box of these sizes. Its corner with the least coordinates is `at`."""
    return Manifold.cube((x, y, z)).translate(at)


def drill(radius: float, at: tuple[float, float, float], turn_deg: tuple[float, float, float] = (0, 0, 0)) -> Manifold:
    """Return a long cylinder through the point `at`, along z unless it is rotated about x, y and z."""
    return Manifold.cylinder(FAR, radius, circular_segments=SIDES, center=True).rotate(turn_deg).translate(at)


def prism(outline: list[tuple[float, float]], height: float) -> Manifold:
    """Return the prism of an outline in the xy plane, from z = 0 to a height."""
    return Manifold.extrude(CrossSection([np.array(outline, float)], FillRule.NonZero), height)


def bracket() -> Manifold:
    """Return an angle bracket with a rib on one side, two holes and a slot."""
    plates = box(34, 24, 4) + box(4, 24, 28)
    rib = prism([(0, 0), (18, 0), (0, 16)], 3).rotate((90, 0, 0)).translate((4, 8, 4))
    slot = box(9, 5, 8, (18, 9.5, -2)) + drill(2.5, (18, 12, 0)) + drill(2.5, (27, 12, 0))
    return plates + rib - slot - drill(2.2, (0, 6, 18), (0, 90, 0)) - drill(3.2, (0, 17, 20), (0, 90, 0))


def connector() -> Manifold:
    """Return a plug with a stepped body, a key, a latch and two contact blades."""
    body = box(22, 14, 16, (-11, -7, 0)) + box(17, 10, 10, (-8.5, -5, 16))
    key = box(4, 2, 9, (-7, 5, 16))
    latch = prism([(0, 0), (3, 0), (1, 8), (0, 8)], 6).rotate((90, 0, 90)).translate((2, 7, 4))
    blades = box(1.6, 6, 9, (-5, -3, 26)) + box(1.6, 4, 9, (4, -3, 26))
    return body + key + latch + blades - drill(2.5, (0, 0, 0)) - box(30, 3, 2, (-15, -8, 3))


def cam() -> Manifold:
    """Return a cam: a disc off its axis with a flat, on a hub with a keyway, and a pin that drives a follower."""
    disc = Manifold.cylinder(8, 17, circular_segments=64).translate((5, 0, 0))
    hub = Manifold.cylinder(20, 8, circular_segments=48)
    pin = Manifold.cylinder(16, 2.5, circular_segments=SIDES).translate((16, 4, 0))
    keyway = box(3, 4, 30, (-1.5, 4, -2))
    return disc + hub + pin - drill(4.5, (0, 0, 0)) - keyway - box(40, 10, 20, (-20, -24, -2))


def clip() -> Manifold:
    """Return a spring clip: a base with a bead, and two arms of different lengths with barbs."""
    bead = Manifold.cylinder(10, 1.5, circular_segments=SIDES).rotate((-90, 0, 0)).translate((13, 0, 0))
    short = prism([(0, 0), (3, 0), (3, 14), (6, 16), (3, 21), (0, 21)], 10).rotate((90, 0, 0)).translate((3, 10, 3))
    tall = prism([(0, 0), (3.5, 0), (3.5, 26), (0, 26), (-2.5, 21), (0, 19)], 6).rotate((90, 0, 0))
    return box(26, 10, 4) + bead + short + tall.translate((19, 8, 3)) - drill(1.6, (20.7, 0, 12), (90, 0, 0))


def housing() -> Manifold:
    """Return a housing: a shell with two bosses, a rib, a window, and a chamfered corner."""
    chamfer = prism([(0, 0), (40, 0), (40, 20), (32, 28), (0, 28)], 15)
    shell = chamfer - box(34, 22, 20, (3, 3, 3))
    bosses = Manifold.cylinder(19, 3.5, circular_segments=SIDES).translate((8, 8, 0))
    bosses += Manifold.cylinder(17, 2.6, circular_segments=SIDES).translate((29, 9, 0))
    rib = box(2, 22, 9, (18, 3, 0))
    return shell + bosses + rib - drill(1.7, (8, 8, 0)) - box(10, 8, 7, (12, -2, 5)) - drill(2, (40, 12, 8), (0, 90, 0))


def shaft() -> Manifold:
    """Return a stepped shaft with a keyway, a flat, a cross hole and a groove."""
    steps = [(0, 0), (4, 0), (5, 1), (5, 14), (8, 14), (8, 20), (7, 21), (7, 34), (6, 34), (6, 36), (7, 36), (7, 44)]
    turned = revolved([*steps, (4, 44), (4, 52), (3, 53), (0, 53)])
    keyway = box(3, 6, 9, (-1.5, 4.5, 23)) + drill(1.5, (0, 7.5, 23), (90, 0, 0)) ^ box(20, 6, 40, (-10, 4.5, 0))
    flat = box(20, 10, 8, (3.2, -5, 4))
    return turned - keyway - flat - drill(1.4, (0, 0, 48), (0, 90, 25))


PARTS = {draw.__name__: draw for draw in (bracket, connector, cam, clip, housing, shaft)}


def write_all(folder: Path) -> list[Path]:
    """Write every part into `folder` as `NAME.ply`, and return the paths."""
    return demo_meshes.write_all(folder, PARTS)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the meshes of the benchmark's held-out parts.")
    parser.add_argument("folder", type=Path, help="folder of the PLY files")
    write_all(parser.parse_args().folder)
