"""The encoder keeps every contract of its slot, and embeddings have the same distances as their maps."""

import numpy as np
from tactile_loc.plugin import SensorGeometry, registry
from tactile_loc.testing import parametrize_with_checks, parametrize_with_properties

from tactile_loc_outline.distances import signed_distances
from tactile_loc_outline.encoder import OutlineEncoder, cosines, low_frequencies

PRESS_M = 0.001
SENSOR = SensorGeometry("orthographic", 80, 80, 4000.0, 4000.0, 40.0, 40.0, 0.02, 0.002)  # 20 x 20 mm
FINE = SENSOR.resize(400, 400)


def with_options(**options) -> OutlineEncoder:
    return OutlineEncoder(OutlineEncoder.Options(**options))


def pressed(x_mm: float, y_mm: float, wide_mm: float, high_mm: float, geometry: SensorGeometry = SENSOR) -> np.ndarray:
    """Return contact depths (1, H, W), metres, of a flat rectangle, from its lowest x and y and its sides, in mm."""
    columns, rows = ((np.arange(n) + 0.5) / n * 20 for n in (geometry.width_px, geometry.height_px))
    inside = [(a >= start) & (a < start + side) for a, start, side in ((rows, y_mm, high_mm), (columns, x_mm, wide_mm))]
    return np.where(inside[0][:, None] & inside[1], 0.0, PRESS_M).astype(np.float32)[None]


@parametrize_with_checks([OutlineEncoder(), with_options(reach_mm=1.0, frequencies=20)])
def test_contract(component, check):
    check(component)


@parametrize_with_properties([OutlineEncoder(), with_options(reach_mm=1.0, frequencies=20)])
def test_property(component, check):
    check(component)


def test_distances_to_a_straight_edge_are_exact():
    mask = np.zeros((2, 10, 40), bool)
    mask[0, :, :15] = True
    mask[1, :4] = True
    across, down = signed_distances(mask, 0.5, 3.0)
    expected = np.clip((15 - (np.arange(40) + 0.5)) * 0.5, -3, 3)
    np.testing.assert_allclose(across, np.tile(expected, (10, 1)), atol=1e-6)
    np.testing.assert_allclose(down[:, 0], np.clip((4 - (np.arange(10) + 0.5)) * 0.5, -3, 3), atol=1e-6)


def test_distances_from_a_disc_equal_distances_to_its_rim():
    y, x = np.indices((101, 101)) - 50.0
    radius = np.hypot(x, y)
    found = signed_distances((radius < 20.3)[None], 1.0, 12.0)[0]
    np.testing.assert_allclose(found, np.clip(20.3 - radius, -12, 12), atol=1.0)
    assert abs(np.mean(found - np.clip(20.3 - radius, -12, 12))) < 0.1


def test_waves_are_orthonormal():
    places = (np.arange(64) + 0.5) / 64
    waves = cosines(places, 20) * 64
    np.testing.assert_allclose(waves @ waves.T / 64, np.eye(20), atol=1e-5)


def test_all_frequencies_keep_the_whole_distance():
    """With every wave of a small image, embeddings have the same distance as their maps (Parseval's theorem)."""
    small = SENSOR.resize(16, 16)
    a, b = (pressed(*sides, small) for sides in ((3, 4, 8, 6), (5, 9, 10, 5)))
    encoder = with_options(frequencies=23, reach_mm=6.0)
    assert low_frequencies(small, 23)[:16, :16].all()
    maps = [signed_distances(d < PRESS_M, small.pixel_pitch_m, 0.006)[0] / 0.006 for d in (a, b)]
    waves = cosines((np.arange(16) + 0.5) / 16, 16)
    whole = [waves @ m @ waves.T for m in maps]
    np.testing.assert_allclose(np.sum((whole[0] - whole[1]) ** 2), np.mean((maps[0] - maps[1]) ** 2), rtol=1e-5)
    kept = low_frequencies(small, 23)[:16, :16]
    assert kept.sum() == 256
    few = with_options(frequencies=9, reach_mm=6.0)
    near = np.sum((few.encode(a, PRESS_M, small) - few.encode(b, PRESS_M, small)) ** 2)
    assert 0.8 * np.mean((maps[0] - maps[1]) ** 2) < near < 1.001 * np.mean((maps[0] - maps[1]) ** 2)
    assert encoder.encode(a, PRESS_M, small).shape == (1, int(low_frequencies(small, 23).sum()))


def test_the_distance_grows_with_displacement_of_disjoint_masks():
    """If a bar 1 mm wide moves by 1 to 5 mm, only the distance of its outline embeddings grows with every step."""
    bars = np.concatenate([pressed(7 + moved, 2, 1, 15) for moved in (0, 1, 2, 3, 5)])
    ours, pixel = (e.encode(bars, PRESS_M, SENSOR) for e in (OutlineEncoder(), registry().create("encoder", "pixel")))
    apart = [np.linalg.norm(vectors[1:] - vectors[0], axis=1) for vectors in (ours, pixel)]
    assert (np.diff(apart[0]) > 0.1 * apart[0][0]).all()
    assert np.ptp(apart[1][1:]) < 1e-3 * apart[1][1]


def test_the_image_size_has_little_effect():
    """Downsampling 400 pixels a side to 100 changes an embedding less than a shift of a third of a millimetre."""
    coarse, fine = (OutlineEncoder().encode(pressed(4, 5, 9, 7, g), PRESS_M, g) for g in (SENSOR, FINE))
    moved = OutlineEncoder().encode(pressed(5, 5, 9, 7), PRESS_M, SENSOR)
    assert np.linalg.norm(coarse - fine) < np.linalg.norm(coarse - moved) / 3


def test_lengths_refer_to_the_sensing_surface_and_not_to_the_camera():
    """A pinhole camera with the same view of 20 x 20 mm gives the same embedding of an imprint."""
    pinhole = SensorGeometry("pinhole", 80, 80, 80.0, 80.0, 40.0, 40.0, 0.02, 0.002)
    a, b = (OutlineEncoder().encode(pressed(4, 5, 9, 7), PRESS_M, g) for g in (SENSOR, pinhole))
    np.testing.assert_allclose(a, b, atol=1e-6)


def test_the_reach_limits_the_distance_to_an_outline():
    apart = []
    for reach_mm in (0.5, 4.0):
        vectors = with_options(reach_mm=reach_mm).encode(
            np.concatenate([pressed(x, 2, 2, 15) for x in (3, 6, 14)]), PRESS_M, SENSOR
        )
        near, far = np.linalg.norm(vectors[1:] - vectors[0], axis=1)
        apart.append(far / near)
    assert apart[0] < 1.1 < 1.3 < apart[1]
