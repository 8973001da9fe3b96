"""Comparison of super-Fibonacci rotations with those of tactile-loc's Hopf grid. This command prints the table:

python -m tactile_loc_super_fibonacci.coverage
"""

import argparse
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin import registry
from tactile_loc.plugin.helpers import draw_rotations, rotation_to_quaternion
from tactile_loc.testing.problems import CAMERAS, make_block

from tactile_loc_super_fibonacci.spirals import super_fibonacci_rotations

Float = NDArray[np.float64]

LEVELS = (0, 1, 2, 3)  # levels of the Hopf grid, which has 72 * 8^level rotations
ASKED = 1_000_000  # number of random rotations


@dataclass(frozen=True)
class Spread:
    """How evenly samples cover all rotations; angles in radians.

    `covering_rad` and `mean_rad` are the largest and mean angle from a random rotation to the nearest sample.
    `closest_rad` and `neighbour_rad` are the smallest and mean angle from a sample to the nearest other sample.
    """

    covering_rad: float
    mean_rad: float
    closest_rad: float
    neighbour_rad: float


def spread_of(R: Float, asked: int = ASKED) -> Spread:
    """Measure the spread of samples R (N, 3, 3), N > 1, with `asked` random rotations."""
    from scipy.spatial import cKDTree

    q = rotation_to_quaternion(R)
    tree = cKDTree(np.concatenate([q, -q]))  # q and -q are the same rotation
    queries = rotation_to_quaternion(draw_rotations(asked, np.random.default_rng(0)))
    nearest = angle_of_chord(tree.query(queries)[0])
    neighbour = angle_of_chord(tree.query(q, k=2)[0][:, 1])
    return Spread(*(float(v) for v in (nearest.max(), nearest.mean(), neighbour.min(), neighbour.mean())))


def angle_of_chord(chord: Float) -> Float:
    """Return the angle, radians, between two rotations. `chord` is the distance between their unit quaternions."""
    return 4 * np.arcsin(np.clip(chord / 2, 0, 1))


def least_covering(count: int) -> float:
    """Return a lower bound of the covering radius, radians, of `count` rotations.

    A ball of angle r has the share (r - sin r) / pi of all rotations. At the bound, the shares of `count` balls sum up
    to one.
    """
    from scipy.optimize import brentq

    return float(brentq(lambda r: (r - np.sin(r)) / np.pi * count - 1, 0.0, np.pi, xtol=1e-14))


def hopf_rotations(level: int) -> Float:
    """Return the rotations (72 * 8^level, 3, 3) of tactile-loc's Hopf grid at a level."""
    hopf = registry().create("grid", "hopf", {"level": level})
    poses = hopf.sample(make_block(), CAMERAS["orthographic"], spacing_m=1.0)  # one place for each rotation
    rotations: Float = poses[:, :3, :3]
    return rotations


def table(levels: tuple[int, ...], asked: int) -> str:
    """Return the comparison as a Markdown table, with angles in degrees."""
    lines = [
        "| rotations | grid | covering radius | over the bound | mean to nearest | closest pair | mean neighbour |",
        "|---|---|---|---|---|---|---|",
    ]
    for level in levels:
        hopf = hopf_rotations(level)
        for name, R in (("hopf", hopf), ("super-fibonacci", super_fibonacci_rotations(len(hopf)))):
            found = spread_of(R, asked)
            angles_rad = found.covering_rad, found.mean_rad, found.closest_rad, found.neighbour_rad
            cells = [f"{np.degrees(angle_rad):.2f}°" for angle_rad in angles_rad]
            cells.insert(1, f"{found.covering_rad / least_covering(len(R)):.2f}")
            lines.append(f"| {len(R)} | {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Write the table to standard output."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asked", type=int, default=ASKED, help="random rotations")
    parser.add_argument(
        "--levels", type=int, nargs="+", default=LEVELS, help="of the Hopf grid: 72 * 8^level rotations"
    )
    arguments = parser.parse_args()
    sys.stdout.write(table(tuple(arguments.levels), arguments.asked) + "\n")


if __name__ == "__main__":
    main()
