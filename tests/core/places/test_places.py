import numpy as np
import pytest

from tactile_loc import SensorGeometry
from tactile_loc.core.places.places import (
    BELOW,
    FAR,
    HIGHEST_M,
    PATCH_PX,
    STEP_M,
    Places,
    average_patches,
    join_patches,
    make_patches,
    split_patches,
)
from tactile_loc.core.sensing.touch import ContactShape, Touch, compute_contact_depth
from tactile_loc.plugin import Progress
from tactile_loc.plugin.helpers import TouchBounds, make_translation, rotate_patches
from tactile_loc.plugins.grids.whole import WholeGrid
from tactile_loc.testing.problems import ReferenceRenderer, make_block

PRESS_M = 8e-4
CAMERAS = {
    "orthographic": SensorGeometry("orthographic", 200, 160, 1e4, 1e4, 100, 80, 0.02, 2e-3),
    "pinhole": SensorGeometry("pinhole", 200, 160, 200.0, 200.0, 100, 80, 0.02, 2e-3),
}


@pytest.fixture(scope="module")
def places() -> Places:
    return WholeGrid(WholeGrid.Options(directions=300)).places(make_block(), Progress())


def test_patches_keep_heights_to_half_a_step_and_mark_far_pixels():
    rise_m = np.array([0.0, 3.3e-4, -1e-4, HIGHEST_M - STEP_M, 1.0, np.inf, np.nan])
    patches = make_patches(rise_m)
    assert patches.tolist()[-3:] == [FAR] * 3
    assert patches[0] == BELOW
    found = Places(np.eye(4)[None], np.full((1, PATCH_PX, PATCH_PX), patches[1])).depths(HIGHEST_M)
    assert found == pytest.approx(3.3e-4, abs=STEP_M / 2)


@pytest.mark.parametrize("press_m", [STEP_M, PRESS_M, HIGHEST_M, 2 * HIGHEST_M])
def test_pixels_without_surface_are_exactly_at_the_press_depth(press_m):
    steps = np.arange(FAR + 1, dtype=np.uint8)
    found = Places(np.eye(4)[None], np.broadcast_to(steps[:, None, None], (FAR + 1, 1, 1))).depths(press_m).ravel()
    assert found[FAR] == np.float32(press_m)
    assert (found[:BELOW] == 0).all()
    assert found[:FAR] == pytest.approx(np.clip((np.arange(FAR) - BELOW) * STEP_M, 0, press_m), rel=1e-6)


@pytest.mark.parametrize("press_m", [2e-4, PRESS_M])
def test_depths_are_cut_at_the_press(places, press_m):
    depths = places.depths(press_m)
    assert depths.min() == 0.0
    assert depths.max() == np.float32(press_m)
    assert (depths[:, PATCH_PX // 2, PATCH_PX // 2] == 0).all()


@pytest.mark.parametrize("camera", list(CAMERAS))
def test_the_unrotated_patch_of_a_touch_equals_that_of_its_place(places, camera):
    geometry = CAMERAS[camera].press(PRESS_M)
    numbers = np.linspace(0, len(places) - 1, 8).astype(int)
    yaw_rad = np.linspace(-3, 3, 8)
    at_m = np.column_stack([np.linspace(-1e-3, 1e-3, 8), np.linspace(1e-3, 0, 8), np.full(8, geometry.standoff_m)])
    poses = make_translation(at_m) @ places.poses(numbers, yaw_rad)
    drawn = compute_contact_depth(ReferenceRenderer().render(make_block().mesh, poses, geometry), geometry, PRESS_M)
    wanted = places.depths(PRESS_M)[numbers]
    for k, depth_m in enumerate(drawn):
        touch = Touch(ContactShape(depth_m, PRESS_M), geometry)
        found, seen = rotate_patches(touch, at_m[k], np.eye(3), yaw_rad[k : k + 1])
        alike = np.abs(found[0] - wanted[k])[seen[0]] < 1e-4
        assert seen.mean() > 0.5
        assert alike.mean() > 0.93, k


def test_places_within_the_bounds_have_no_excess_and_others_the_sum_of_squares(places):
    rng, numbers, yaws = np.random.default_rng(0), np.array([0, 3, 5, 3]), np.array([0, 1, 1, 0])
    heights_m = (places.patches.astype(float) - BELOW) * STEP_M
    low_m = rng.uniform(0, 5e-4, (2, PATCH_PX, PATCH_PX)).astype(np.float32)
    high_m = np.where(rng.random(low_m.shape) < 0.5, low_m, np.float32(np.inf))
    low_m[:, :5] = -np.inf
    high_m[:, :5] = np.inf
    most_m = 2e-4
    out_m = np.maximum(low_m[yaws] - heights_m[numbers], heights_m[numbers] - high_m[yaws])
    wanted = np.square(np.clip(out_m, 0, most_m)).sum(axis=(1, 2))
    found = TouchBounds(np.eye(4), low_m, high_m, most_m).measure_excess(places, numbers, yaws)
    assert found == pytest.approx(wanted, rel=1e-4)
    own_m = heights_m[numbers].astype(np.float32)
    own = TouchBounds(np.eye(4), own_m, own_m, most_m)
    assert own.measure_excess(places, numbers, np.arange(4)) == pytest.approx(0, abs=1e-14)


def test_unobserved_pixels_are_not_seen_in_rotated_patches(places):
    observed = np.ones((160, 200), bool)
    observed[:, :100] = False
    geometry = SensorGeometry("orthographic", 200, 160, 1e4, 1e4, 100, 80, 0.02, 2e-3, observed=observed)
    depth_m = np.full((160, 200), 1e-4, np.float32)
    depth_m[80:] = PRESS_M
    touch = Touch(ContactShape(depth_m, PRESS_M), geometry)
    depths, seen = rotate_patches(touch, np.zeros(3), np.eye(3), np.array([0.0, np.pi / 2]))
    middle = PATCH_PX // 2
    assert not seen[0, :, :middle].any()
    assert seen[0, middle, middle + 1 : middle + 15].all()
    assert not seen[1, middle + 1 :, middle].any()  # a rotation back by 90 degrees moves the left side below
    assert (depths[~seen] == np.float32(PRESS_M)).all()


def test_a_pose_puts_its_place_at_the_given_point(places):
    at_m = np.array([[1e-3, -2e-3, 0.0195]])
    (T,) = make_translation(at_m) @ places.poses(np.array([5]), np.array([0.7]))
    place = np.linalg.inv(places.T_place_object[5]) @ [0, 0, 0, 1]
    assert (T @ place)[:3] == pytest.approx(at_m[0], abs=1e-12)
    assert T[2, :3] == pytest.approx(places.T_place_object[5][2, :3])


def test_any_patches_are_the_same_after_splitting_and_joining():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, FAR + 1, (3, PATCH_PX, PATCH_PX), np.uint8)
    for patches in (noise, np.where(rng.random(noise.shape) < 0.8, FAR, noise), 0 * noise, 0 * noise + FAR, noise[:0]):
        for some in (patches, patches[:, ::-1]):
            joined = join_patches(*split_patches(some))
            assert joined.dtype == np.uint8
            assert np.array_equal(joined, some)


def draw_weights(cells: int, pixels: int, rng: np.random.Generator) -> np.ndarray:
    """Return random weights (cells, pixels) of pixels that are in one cell or in two neighbours."""
    weights = np.zeros((cells, pixels), np.float32)
    for pixel in range(pixels):
        first = int(rng.integers(cells))
        weights[first : first + int(rng.integers(1, 3)), pixel] = rng.uniform(0.1, 1)
    return weights


@pytest.mark.parametrize(("down", "across"), [(1, 1), (1, 5), (3, 2), (6, 9)])
@pytest.mark.parametrize("shape", [(9, 9), (4, 11)])
def test_sums_are_matrix_products(down, across, shape):
    rng = np.random.default_rng(3)
    patches = rng.integers(0, 256, (7, *shape)).astype(np.uint8)
    rows, columns = draw_weights(down, shape[0], rng), draw_weights(across, shape[1], rng)
    for end in (0, 1, 90, 256):
        signal = np.where(np.arange(256) < end, rng.normal(size=256), 0).astype(np.float32)
        found = average_patches(patches, signal, rows, columns)
        assert found == pytest.approx(rows @ signal[patches] @ columns.T, abs=1e-4)


@pytest.mark.parametrize("cells", [[0, 1, 2], [0, 2]])
def test_a_pixel_in_too_many_cells_is_refused(cells):
    weights = np.zeros((3, 4), np.float32)
    weights[cells, 1] = 1
    patches, signal = np.zeros((1, 4, 4), np.uint8), np.ones(256, np.float32)
    for rows, columns in ((weights, np.ones((1, 4), np.float32)), (np.ones((1, 4), np.float32), weights)):
        with pytest.raises(ValueError, match="cells"):
            average_patches(patches, signal, rows, columns)
