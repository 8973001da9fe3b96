"""Comparison of super-Fibonacci and Hopf contact grids of equal spacing, by their coverage of an object's poses.

python -m tactile_loc_super_fibonacci.on_objects pin cotter hook
"""

import argparse
import sys

import numpy as np
from tactile_loc import Localizer
from tactile_loc.plugin.helpers import draw_contact_poses, make_contact_grid

HEAD = "| object | symmetry | grid | poses | mean spacing | median to nearest | 95 % to nearest | mean to nearest |"
GRIDS = ("hopf", "super-fibonacci")


def row(name: str, grid: str, spacing_mm: float, asked: int) -> str:
    """Return the table's row for an object and a grid, with RMS surface distances in mm.

    "To nearest" is the distance from a random contact pose to the nearest pose of the grid. Both grids get the same
    random poses.
    """
    locate, drawer = (Localizer.create(name, grid={"name": g, "spacing_mm": spacing_mm}) for g in (grid, GRIDS[0]))
    poses = make_contact_grid(locate.sampler, locate.coarse_scene)
    drawn = draw_contact_poses(drawer.sampler, drawer.coarse_scene, asked, np.random.default_rng(0))
    nearest_mm = poses.nearest(drawn)[0] * 1e3
    numbers = (np.median(nearest_mm), np.quantile(nearest_mm, 0.95), nearest_mm.mean())
    cells = [name, str(locate.object.symmetry), grid, f"{len(poses):,}", f"{poses.spacing_m * 1e3:.2f} mm"]
    return f"| {' | '.join([*cells, *(f'{number:.2f} mm' for number in numbers)])} |"


def main() -> None:
    """Write the table to standard output."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("objects", nargs="+", help="demo objects or mesh files")
    parser.add_argument("--spacing-mm", type=float, default=8.0, help="mean distance between neighbouring poses")
    parser.add_argument("--asked", type=int, default=2000, help="random contact poses")
    arguments = parser.parse_args()
    sys.stdout.write(f"{HEAD}\n|{'---|' * 8}\n")
    for name in arguments.objects:
        for grid in GRIDS:
            sys.stdout.write(row(name, grid, arguments.spacing_mm, arguments.asked) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
