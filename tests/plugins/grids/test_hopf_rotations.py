from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactile_loc.core.geometry import random_rotations, rotation_angle, rotation_to_quaternion
from tactile_loc.plugins.grids.hopf_rotations import children, hopf_rotations, pixel_angles, rotation_count


def centres(nside: int) -> np.ndarray:
    z, azimuth_rad = pixel_angles(nside, np.arange(12 * nside**2))
    s = np.sqrt(1 - z**2)
    return np.stack([s * np.cos(azimuth_rad), s * np.sin(azimuth_rad), z], axis=-1)


def ring_scheme(nside: int) -> np.ndarray:
    """The pixel centres by the ring formulas of Gorski et al. 2005, equations 4 to 9, written out pixel by pixel."""
    found = []
    for i in range(1, 4 * nside):
        if i < nside or i > 3 * nside:
            k = min(i, 4 * nside - i)
            z = (1 - k**2 / (3 * nside**2)) * (1 if i < nside else -1)
            azimuth = [np.pi / (2 * k) * (j - 0.5) for j in range(1, 4 * k + 1)]
        else:
            z, s = 4 / 3 - 2 * i / (3 * nside), (i - nside + 1) % 2
            azimuth = [np.pi / (2 * nside) * (j - s / 2) for j in range(1, 4 * nside + 1)]
        found += [(np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z) for a in azimuth]
    return np.array(found)


def largest_pixel_radius(nside: int) -> float:
    """Radians from a pixel's centre to its farthest corner: the bound that the HEALPix library states."""
    z, azimuth, rim = 2 / 3, np.pi / (4 * nside), 1 - (1 - 1 / nside) ** 2 / 3
    a = np.array([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z])
    return float(np.arccos(a @ [np.sqrt(1 - rim * rim), 0.0, rim]))


def to_nearest(R: np.ndarray, grid: np.ndarray, k: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Angle in radians to, and index of, the k-th nearest grid rotation: by quaternions, of both signs."""
    q = rotation_to_quaternion(grid)
    chord, index = cKDTree(np.concatenate([q, -q])).query(rotation_to_quaternion(R), k=[k])
    return 4 * np.arcsin(chord[:, 0] / 2), index[:, 0] % len(grid)


def test_base_pixels_are_where_healpix_has_them():
    z, azimuth_rad = pixel_angles(1, np.arange(12))
    np.testing.assert_allclose(z, np.repeat([2 / 3, 0, -2 / 3], 4), atol=1e-15)
    north, equator = [45, 135, 225, 315], [0, 90, 180, 270]
    np.testing.assert_allclose(np.degrees(azimuth_rad) % 360, [*north, *equator, *north])


def test_known_pixels_of_nside_2():
    z, azimuth_rad = pixel_angles(2, np.arange(48))
    rings, counts = np.unique(z.round(12), return_counts=True)
    np.testing.assert_allclose(rings, [-11 / 12, -2 / 3, -1 / 3, 0, 1 / 3, 2 / 3, 11 / 12], atol=1e-12)
    assert counts.tolist() == [4, 8, 8, 8, 8, 8, 4]
    for ring_z, first in ((11 / 12, 45.0), (2 / 3, 22.5), (1 / 3, 0.0), (0.0, 22.5)):
        on_ring = np.sort(np.degrees(azimuth_rad[np.isclose(z, ring_z)]).round(9) % 360)
        np.testing.assert_allclose(on_ring, first + 360 / len(on_ring) * np.arange(len(on_ring)))


@pytest.mark.parametrize("nside", [1, 2, 3, 5, 8])
def test_centres_are_those_of_the_ring_scheme_for_any_nside(nside):
    ours, theirs = centres(nside), ring_scheme(nside)
    distance, index = cKDTree(theirs).query(ours)
    assert distance.max() < 1e-12
    assert len(np.unique(index)) == len(theirs) == 12 * nside**2


def test_pixels_have_equal_area():
    # Moments that an equal-area grid integrates exactly, or nearly: <1>, <x>, <x x^T> = I / 3.
    p = centres(8)
    np.testing.assert_allclose(p.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(p.T @ p / len(p), np.eye(3) / 3, atol=2e-3)
    # Pixels wholly north of z = 2/3 are a sixth of all, as that cap is a sixth of the sphere; the ring at 2/3 is cut.
    north = (p[:, 2] > 2 / 3 + 1e-9).sum() + 0.5 * np.isclose(p[:, 2], 2 / 3).sum()
    assert north == len(p) / 6


@pytest.mark.parametrize("level", [0, 1, 2])
def test_counts_and_proper_distinct_rotations(level):
    n = 2**level
    R = hopf_rotations(n, 6 * n)
    assert len(R) == rotation_count(n, 6 * n) == 72 * 8**level
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    np.testing.assert_allclose(R[:: 6 * n, :, 2], centres(n), atol=1e-12)  # z turns to the pixel's centre


@pytest.mark.parametrize(("nside", "spacing_deg"), [(1, 60.0), (2, 30.0), (3, 20.0), (4, 15.0)])
def test_neighbours_are_at_the_published_spacing(nside, spacing_deg):
    R = hopf_rotations(nside, 6 * nside)
    nearest_deg = np.degrees(to_nearest(R, R, k=2)[0])
    assert 0.93 * spacing_deg < nearest_deg.mean() <= spacing_deg * (1 + 1e-9)
    assert nearest_deg.max() <= spacing_deg * (1 + 1e-9)  # the next spin is never farther
    assert nearest_deg.min() > 0.8 * spacing_deg


@pytest.mark.parametrize("nside", [1, 2, 3, 4])
def test_no_rotation_is_farther_than_a_cell_reaches(nside):
    """Swing to the centre of the pixel, then spin to the nearest spin: the axes are at right angles, so the half

    angles' cosines multiply. Together they bound the distance from any rotation to the grid.
    """
    bound = 2 * np.arccos(np.cos(largest_pixel_radius(nside) / 2) * np.cos(np.pi / (6 * nside) / 2))
    angle, _ = to_nearest(random_rotations(20_000, np.random.default_rng(0)), hopf_rotations(nside, 6 * nside))
    assert 0.75 * bound < angle.max() <= bound


@pytest.mark.parametrize("nside", [1, 2])
def test_each_rotation_is_nearest_to_its_share(nside):
    grid = hopf_rotations(nside, 6 * nside)
    _, index = to_nearest(random_rotations(20_000, np.random.default_rng(1)), grid)
    share = np.bincount(index, minlength=len(grid)) * (len(grid) / 20_000)
    chance = np.sqrt(len(grid) / 20_000)
    assert np.abs(share - 1).max() < 4.5 * chance
    assert share.std() < 1.1 * np.hypot(chance, 0.1)  # cells differ by some per cent beside the draw's own noise


def test_indices_pick_from_the_whole():
    some = np.array([5, 700, 0, 5])
    np.testing.assert_array_equal(hopf_rotations(4, 11, some), hopf_rotations(4, 11)[some])


def test_children_cut_every_cell_into_eight_around_its_centre():
    nside, n_psi = 3, 18
    coarse, fine = hopf_rotations(nside, n_psi), hopf_rotations(2 * nside, 2 * n_psi)
    family = children(np.arange(len(coarse)), nside, n_psi)
    assert np.array_equal(np.sort(family.ravel()), np.arange(len(fine)))  # a partition of the finer grid
    step = rotation_angle(np.swapaxes(coarse, 1, 2)[:, None] @ fine[family])
    # Spins are counted from a frame that turns with the azimuth near the south pole, where cells are sheared.
    north = coarse[:, 2, 2] > 0
    reach = 2 * np.arccos(np.cos(largest_pixel_radius(nside) / 2) * np.cos(np.pi / n_psi / 2))
    assert step[north].max() < reach
    assert step.min() > np.pi / n_psi / 2 * (1 - 1e-9)
    assert (fine[family][..., 2] * coarse[:, None, :, 2]).sum(-1).min() > np.cos(largest_pixel_radius(nside))
