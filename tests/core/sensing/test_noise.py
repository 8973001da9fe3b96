"""Each imperfection alone, compared with known values in metres on the surface."""

import dataclasses
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from message_helpers import naming
from scipy.ndimage import label
from scipy.spatial.transform import Rotation
from scipy.special import ndtr
from tactile_loc_cli.options import Noise

from tactile_loc import ContactShape, SensorGeometry
from tactile_loc.core.sensing.noise import NOISE, TouchNoise, make_noise
from tactile_loc.io.config import TouchConfig
from tactile_loc.plugin import ConfigError
from tactile_loc.plugin.helpers import is_rigid, rotation_about

PRESS_M = 0.002


def sensor(px: int = 80, size_m: float = 0.04, **more) -> SensorGeometry:
    """Return an orthographic sensor with a square field."""
    k = px / size_m
    return SensorGeometry("orthographic", px, px, k, k, px / 2, px / 2, 0.01, PRESS_M, **more)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def corrupted(part: TouchNoise, depth: np.ndarray, geometry: SensorGeometry, press_m=PRESS_M, seed: int = 0):
    return part.corrupt(depth, np.full(len(depth), press_m), geometry, rng(seed))


def deep(count: int, px: int = 80) -> np.ndarray:
    return np.zeros((count, px, px), np.float32)


def empty(count: int, px: int = 80) -> np.ndarray:
    return np.full((count, px, px), PRESS_M, np.float32)


@pytest.fixture
def shapes(make_scene, pinhole, box) -> np.ndarray:
    """Return clean contact depths of a box at full press, at several tilts."""
    R = rotation_about([1, 2, 0], np.linspace(0.02, 0.4, 12))
    T = np.tile(np.eye(4), (12, 1, 1))
    T[:, :3, :3] = R
    scene = make_scene(box, pinhole)
    return scene.render_contact_depths(scene.bring_to_contact(T)[0])


def test_every_noise_level_can_be_selected():
    assert [make_noise(name) for name in NOISE] == list(NOISE.values())
    assert list(get_args(TouchConfig.model_fields["noise"].annotation)) == list(Noise) == list(NOISE)
    with pytest.raises(ConfigError, match=naming("'mlid'", *NOISE, "'mild'")):
        make_noise("mlid")


@pytest.mark.parametrize(
    "wrong",
    [
        {"press_share": (0.0, 1.0)},
        {"press_share": (0.5, 1.1)},
        {"press_share": (1.0, 0.5)},
        {"missing": -1.0},
        {"smoothing_m": float("nan")},
        {"sensor_rad": float("inf")},
        {"edge_patch_m": 0.0},
    ],
)
def test_impossible_values_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        TouchNoise(**wrong)


def test_press_depths_are_uniform_in_their_range():
    press = TouchNoise(press_share=(0.5, 0.8)).draw_press(20_000, 0.002, rng())
    assert 0.001 <= press.min() < 0.00101
    assert 0.00159 < press.max() <= 0.0016
    assert np.histogram(press, 4, (0.001, 0.0016))[0] / 20_000 == pytest.approx(np.full(4, 0.25), abs=0.015)


def test_the_measured_press_has_the_given_error_and_range():
    press = np.full(20_000, 0.001)
    ratio = TouchNoise(press_error=0.05).measure_press(press, 0.002, rng()) / press
    assert ratio.mean() == pytest.approx(1.0, abs=0.002)
    assert ratio.std() == pytest.approx(0.05, rel=0.03)
    wild = TouchNoise(press_error=2.0).measure_press(press, 0.002, rng())
    assert wild.min() == pytest.approx(1e-4)
    assert wild.max() == 0.002


@pytest.mark.parametrize("camera", ["flat_camera", "pinhole"])
def test_the_sensor_is_misplaced_by_its_error_in_any_object_frame(camera, request):
    geometry = request.getfixturevalue(camera)
    x0, x1, y0, y1 = geometry.rectangle
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, geometry.standoff_m, 1.0])
    T = np.tile(np.eye(4), (20_000, 1, 1))
    T[:, :3, :3] = rotation_about([0.3, 1, 0.2], 0.7)
    T[:, :3, 3] = [0.5, -0.2, 1.0]  # the frame's origin is far from the sensor
    moved = TouchNoise(sensor_m=3e-4, sensor_rad=0.02).misplace(T, geometry, rng())
    assert is_rigid(moved[0])
    shift = (moved @ np.linalg.inv(T[0]) @ centre - centre)[:, :3]
    assert shift.std(axis=0) == pytest.approx(np.full(3, 3e-4), rel=0.03)
    turn = Rotation.from_matrix(moved[:, :3, :3] @ T[0, :3, :3].T).as_rotvec()
    assert turn.std(axis=0) == pytest.approx(np.full(3, 0.02), rel=0.03)
    assert np.abs(turn.mean(axis=0)).max() < 6e-4


def test_the_level_none_changes_nothing(shapes, pinhole):
    none = NOISE["none"]
    T = np.tile(np.eye(4), (3, 1, 1)) + 1e-3
    assert np.array_equal(none.misplace(T, pinhole, rng()), T)
    assert np.array_equal(none.draw_press(5, 0.002, rng()), np.full(5, 0.002))
    press = np.array([1e-6, 1.3e-3, 2e-3])
    assert np.array_equal(none.measure_press(press, 0.002, rng()), press)
    assert np.array_equal(corrupted(none, shapes, pinhole), shapes)
    cut = corrupted(none, shapes, pinhole, 0.0013)
    assert np.array_equal(cut, np.minimum(shapes, np.float32(0.0013)))
    press = np.full(len(cut), 0.0013)
    assert none.cut(cut, press, press).tobytes() == cut.tobytes()


@pytest.mark.parametrize("level", NOISE)
def test_noise_gives_valid_depths_and_keeps_its_input(shapes, pinhole, level):
    before = shapes.copy()
    press = rng(1).uniform(0.001, 0.002, len(shapes))
    noisy = NOISE[level].corrupt(shapes, press, pinhole, rng(2))
    assert np.array_equal(shapes, before)
    assert noisy.dtype == np.float32
    assert noisy.shape == shapes.shape
    assert np.isfinite(noisy).all()
    assert (noisy >= 0).all()
    assert (noisy <= press.astype(np.float32)[:, None, None]).all()
    assert (
        (noisy < shapes.max()) & (noisy == press.astype(np.float32)[:, None, None])
    ).any()  # pixels without contact have the press depth


def test_the_seed_determines_the_noise(shapes, pinhole):
    a, b, c = (corrupted(NOISE["strong"], shapes, pinhole, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)


@pytest.mark.parametrize("px", [20, 64, 160])
@pytest.mark.parametrize("across", [1, 2])
def test_smoothing_turns_a_step_into_the_error_function(px, across):
    depth = deep(1, px)
    depth[:, :, px // 2 :] = PRESS_M
    smooth = corrupted(TouchNoise(smoothing_m=7e-4), depth if across == 2 else depth.swapaxes(1, 2), sensor(px))
    profile = (smooth if across == 2 else smooth.swapaxes(1, 2))[0, px // 3]
    x_m = (np.arange(px) + 0.5 - px / 2) * 0.04 / px
    assert profile == pytest.approx(PRESS_M * ndtr(x_m / 7e-4), abs=1e-4 * PRESS_M)


def test_noise_does_not_cross_the_sensing_rectangle():
    """Pixels outside the rectangle get no noise and do not affect others; a mask only hides pixels."""
    rectangle = (-0.01, 0.012, -0.015, 0.01)
    part, whole = sensor(rectangle_m=rectangle), sensor()
    inside = part.observed_mask
    depth = np.where(inside, rng().uniform(0, PRESS_M, (4, 80, 80)), 0.0).astype(np.float32)
    other = np.where(inside, depth, PRESS_M).astype(np.float32)
    strong = NOISE["strong"]
    a, b = corrupted(strong, depth, part), corrupted(strong, other, part)
    assert np.array_equal(a[:, inside], b[:, inside])
    assert np.array_equal(a[:, ~inside], depth[:, ~inside])
    masked = sensor(observed=rng(1).random((80, 80)) < 0.5)
    assert np.array_equal(corrupted(strong, depth, masked), corrupted(strong, depth, whole))


def test_a_shallow_imprint_is_not_visible():
    depth = np.broadcast_to(np.linspace(0, PRESS_M, 80, dtype=np.float32), (1, 80, 80))
    shown = corrupted(TouchNoise(least_m=5e-4), depth, sensor())
    kept = depth < PRESS_M - 5e-4
    assert np.array_equal(shown[kept], depth[kept])
    assert (shown[~kept] == np.float32(PRESS_M)).all()


@pytest.mark.parametrize("px", [100, 400])
def test_the_edge_varies_with_its_height_and_patch_size(px):
    """On a ramp the edge moves by height / slope; its correlation along the edge is that of the patches."""
    slope, edge_m, patch_m = PRESS_M / 0.04, 5e-5, 1e-3
    ramp = (np.arange(px) + 0.5) / px * 0.04 * slope
    depth = np.tile(ramp.astype(np.float32), (40, px, 1))
    wandering = TouchNoise(least_m=6e-4, edge_m=edge_m, edge_patch_m=patch_m)
    shown = corrupted(wandering, depth, sensor(px))
    height = (shown < np.float32(PRESS_M)).sum(axis=2) / px * PRESS_M  # height of the ramp at the edge
    quantum = PRESS_M / px / np.sqrt(12)  # the rounding to pixels
    assert height.mean() == pytest.approx(PRESS_M - 6e-4, abs=5e-6)
    assert height.std() == pytest.approx(np.hypot(edge_m, quantum), rel=0.12)
    h = height - height.mean()
    step = round(2 * patch_m * px / 0.04)
    near = (h[:, step:] * h[:, :-step]).mean() / h.var()
    assert near == pytest.approx(np.exp(-1.0), abs=0.12)  # two patches apart: exp(-d^2 / 4 patch^2)
    assert np.array_equal(shown[shown < PRESS_M], depth[shown < PRESS_M])  # visible depths are unchanged


def test_the_varying_edge_stays_within_the_imprint():
    depth = empty(4)
    depth[:, 20:60, 20:60] = PRESS_M - 1e-4
    shown = corrupted(TouchNoise(least_m=5e-5, edge_m=1e-3), depth, sensor())
    contact = shown < np.float32(PRESS_M)
    assert 0.2 < contact[:, 20:60, 20:60].mean() < 0.8
    assert not contact[depth == np.float32(PRESS_M)].any()


@pytest.mark.parametrize("px", [80, 240])
def test_only_visible_depths_drift(px):
    drift_m, patch_m = 1e-4, 4e-3
    depth = empty(60, px)
    depth[:, : px // 2] = PRESS_M / 2
    off = corrupted(TouchNoise(drift_m=drift_m, drift_patch_m=patch_m), depth, sensor(px)) - depth
    assert not off[:, px // 2 :].any()
    inside = off[:, : px // 2]
    assert inside.mean() == pytest.approx(0, abs=1.5e-5)
    assert inside.std() == pytest.approx(drift_m, rel=0.1)
    step = round(2 * patch_m * px / 0.04)
    near = (inside[:, :, step:] * inside[:, :, :-step]).mean() / inside.var()
    assert near == pytest.approx(np.exp(-1.0), abs=0.12)


def test_drift_does_not_change_the_visible_contact():
    depth = empty(4)
    depth[:, 20:40], depth[:, 40:60] = PRESS_M - 1e-5, 0.0
    shown = corrupted(TouchNoise(drift_m=1e-3), depth, sensor())
    assert np.array_equal(shown < np.float32(PRESS_M), depth < np.float32(PRESS_M))
    assert shown.min() >= 0


@pytest.mark.parametrize("px", [80, 240])
@pytest.mark.parametrize(
    ("part", "clean", "mean_square"),  # of radii U(0.3, 1) and U(0.2, 0.7) of the patch size
    [(TouchNoise(missing=0.5, patch_m=1e-3), deep, 0.4633), (TouchNoise(spurious=0.5, patch_m=2e-3), empty, 0.2233)],
    ids=["missing", "spurious"],
)
def test_patches_have_the_given_number_and_size(px, part, clean, mean_square):
    """The mean area of a disc is pi times its mean squared radius; few discs overlap."""
    shapes = clean(300, px)
    changed = corrupted(part, shapes, sensor(px)) != shapes
    assert changed.any(axis=(1, 2)).mean() == pytest.approx(1 - np.exp(-0.5), abs=0.09)
    numbers = np.array([label(image)[1] for image in changed])
    assert numbers.mean() == pytest.approx(0.5, abs=0.13)
    assert numbers.var() == pytest.approx(0.5, abs=0.25)
    area_m2 = changed.sum() * (0.04 / px) ** 2 / numbers.sum()
    assert area_m2 == pytest.approx(np.pi * part.patch_m**2 * mean_square, rel=0.15)


def test_missing_patches_remove_whole_contacts_and_add_none():
    lost = corrupted(TouchNoise(missing=9), deep(3), sensor())
    assert set(np.unique(lost)) == {0.0, np.float32(PRESS_M)}
    depth = empty(50)
    depth[::2, 10:12, 60:62] = 0.0
    assert np.array_equal(corrupted(TouchNoise(missing=50.0, patch_m=5e-3), depth, sensor()), empty(50))


def test_spurious_patches_have_a_depth_of_the_press_and_remove_no_contact():
    shown = corrupted(TouchNoise(spurious=0.5, patch_m=2e-3), empty(300), sensor())
    imprint = 1 - shown[shown < np.float32(PRESS_M)] / PRESS_M
    assert 0.1 - 1e-6 <= imprint.min() < 0.15
    assert 0.45 < imprint.max() <= 0.5 + 1e-6
    assert np.array_equal(corrupted(TouchNoise(spurious=20.0), deep(3), sensor()), deep(3))


def test_the_border_is_lost_on_one_side_only():
    border = corrupted(TouchNoise(border_m=8e-3), deep(400, 160), sensor(160)) > 0
    widths = np.stack(
        [border[:, 80, :80].sum(1), border[:, 80, 80:].sum(1), border[:, :80, 80].sum(1), border[:, 80:, 80].sum(1)]
    )
    assert ((widths > 0).sum(axis=0) <= 1).all()
    assert (widths > 0).mean(axis=1) == pytest.approx(np.full(4, 0.25), abs=0.08)
    assert widths.max() * 0.04 / 160 == pytest.approx(8e-3, abs=3e-4)
    assert widths.sum(axis=0).mean() * 0.04 / 160 == pytest.approx(4e-3, rel=0.1)
    side = widths.argmax(axis=0)
    left = border[(side == 0) & (widths[0] > 0)][0]
    assert np.array_equal(left, np.tile(left[0], (160, 1)))
    assert np.array_equal(np.sort(left[0])[::-1], left[0])  # from the border inwards


@pytest.mark.parametrize(("measured_m", "contact"), [(0.0010, [1, 1, 0, 0]), (0.0018, [1, 1, 1, 0])])
def test_a_contact_shape_is_cut_at_the_measured_press(measured_m, contact):
    depth = np.array([[0.0, 0.0008, 0.0012, 0.0015]], np.float32)  # the press is 1.5 mm: the last pixel has no contact
    pair = TouchNoise().cut(np.stack([depth, depth]), np.array([0.0015, 0.0015]), np.array([measured_m, 0.0015]))
    assert np.array_equal(pair[1], depth)
    shape = ContactShape(pair[0], measured_m)
    assert shape.contact.tolist() == [[bool(c) for c in contact]]
    assert np.array_equal(shape.depth_m[shape.contact], depth[shape.contact])
    assert (shape.depth_m[~shape.contact] >= np.float32(measured_m)).all()
    assert shape.depth_m.dtype == np.float32


def test_the_documented_levels_match_the_program():
    page = (Path(__file__).parents[3] / "docs" / "method-gel.md").read_text()
    table = page.split("## Settings\n")[1].split("\n## ")[0]
    for line in documented_rows():
        assert line in table


def documented_rows() -> list[str]:
    """Return the expected lines of the table in docs/method-gel.md."""
    mm, percent = (lambda v: f"{1e3 * v:g} mm" if v else "0"), (lambda v: f"{100 * v:g} %" if v else "0")
    write = {
        "press_share": lambda v: f"{100 * v[0]:g} to {100 * v[1]:g} %" if v[0] < v[1] else f"{100 * v[0]:g} %",
        "press_error": percent,
        "missing": "{:g}".format,
        "spurious": "{:g}".format,
        "sensor_rad": lambda v: f"{np.degrees(v):.3g}°" if v else "0",
    }
    used = {  # a patch size has no effect without patches
        "edge_patch_m": lambda level: level.edge_m,
        "drift_patch_m": lambda level: level.drift_m,
        "patch_m": lambda level: level.missing + level.spurious,
    }
    rows = []
    for field in dataclasses.fields(TouchNoise):
        cells = [
            write.get(field.name, mm)(getattr(level, field.name)) if used.get(field.name, bool)(level) else "-"
            for level in NOISE.values()
        ]
        rows.append(f"| `{field.name}` | " + " | ".join(cells) + " |")
    return rows
