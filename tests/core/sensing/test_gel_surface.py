"""What an elastic gel shows, and where it touches the object."""

import dataclasses
import math

import numpy as np
import pytest

from tactile_loc import ContactShape, SensorGeometry, Touch
from tactile_loc.core.sensing import gel_surface
from tactile_loc.core.sensing.gel import Gel, compute_compliance, compute_smoothing, list_wave_numbers, make_solver
from tactile_loc.core.sensing.gel_surface import deform_gel, find_touching, recover_contact
from tactile_loc.plugins.sensors.presets import GelSightMini, GelSlim
from tactile_loc.sensors.reading.surface import differentiate

PRESS_M = 6e-4
LAYER = Gel(4e-3, 0.48)
SENSORS = {"parallel rays": GelSightMini(), "pinhole": GelSlim()}


@pytest.fixture(params=SENSORS)
def geometry(request) -> SensorGeometry:
    return dataclasses.replace(SENSORS[request.param].geometry.press(PRESS_M), gel=LAYER)


def draw(name: str, geometry: SensorGeometry) -> np.ndarray:
    """The contact depths (1, H, W), metres, of an object in a rigid gel."""
    k = geometry.surface_m if geometry.is_pinhole else 1.0
    x, y = np.meshgrid(*(slopes * k for slopes in geometry.pixel_slopes))
    block = (np.abs(x) < 3e-3) & (np.abs(y) < 2e-3)
    height_m = {
        "sphere": 3e-3 - np.sqrt(np.maximum(9e-6 - x**2 - y**2, 0)),
        "cone": np.hypot(x, y),
        "block": np.where(block, (x + 3e-3) * math.tan(math.radians(8)), 1.0),
    }[name]
    return np.minimum(height_m, PRESS_M)[None].astype(np.float32)


def resolve_fully(monkeypatch) -> None:
    """Solve contacts at every pixel of the whole image."""
    monkeypatch.setattr(gel_surface, "PITCH_M", 1e-5)
    monkeypatch.setattr(gel_surface, "MARGIN", math.inf)


@pytest.mark.parametrize("name", ["sphere", "cone", "block"])
def test_the_solved_pixels_change_the_surface_little(name, geometry, monkeypatch):
    """The window and its coarse pixels cost at most a tenth of what elasticity changes."""
    rigid = draw(name, geometry)
    found = deform_gel(rigid, PRESS_M, geometry)
    resolve_fully(monkeypatch)
    exact = deform_gel(rigid, PRESS_M, geometry, 30)
    off_m, elastic_m = (np.sqrt(np.mean((shown - exact) ** 2)) for shown in (found, rigid))
    assert off_m < 0.2 * elastic_m
    assert off_m < 7e-6


def test_a_gel_is_displaced_wherever_the_object_is(geometry):
    rigid = draw("block", geometry)
    shown = deform_gel(rigid, PRESS_M, geometry)
    assert (shown <= rigid + 1e-9).all()
    assert np.count_nonzero(shown < 0.9 * PRESS_M) > 1.3 * np.count_nonzero(rigid < 0.9 * PRESS_M)


def test_there_is_no_gel_beyond_the_rectangle(geometry):
    x0, x1, y0, y1 = geometry.rectangle
    half = dataclasses.replace(geometry, rectangle_m=(x0, (x0 + x1) / 2, y0, y1))
    shown = deform_gel(draw("sphere", geometry), PRESS_M, half)
    assert (shown[:, ~half.on_rectangle] == np.float32(PRESS_M)).all()
    assert (shown[:, half.on_rectangle] < PRESS_M).any()


def test_a_rigid_gel_shows_the_object_itself(geometry):
    rigid = draw("sphere", geometry)
    assert deform_gel(rigid, PRESS_M, dataclasses.replace(geometry, gel=Gel())) is rigid


def test_presses_of_a_batch_may_differ(geometry):
    rigid = np.concatenate([draw("sphere", geometry)] * 2)
    presses_m = np.array([2e-4, PRESS_M])
    both = deform_gel(np.minimum(rigid, presses_m[:, None, None].astype(np.float32)), presses_m, geometry)
    for shown, press_m in zip(both, presses_m, strict=True):
        alone = deform_gel(np.minimum(rigid[:1], np.float32(press_m)), press_m, geometry)
        assert np.abs(shown - alone[0]).max() < 0.02 * press_m


@pytest.mark.parametrize("name", ["sphere", "cone", "block"])
def test_touching_pixels_are_found_from_the_surface_alone(name, geometry, monkeypatch):
    """They agree with the pixels under pressure, and exclude most of the gel that is displaced beside the contact."""
    resolve_fully(monkeypatch)
    rigid = draw(name, geometry)
    shown = deform_gel(rigid, PRESS_M, geometry, 30)[0]
    touching = np.abs(shown - rigid[0]) < 1e-8
    touching &= rigid[0] < PRESS_M
    monkeypatch.undo()
    found = find_touching(shown, PRESS_M, geometry)
    assert np.count_nonzero(found & touching) > 0.6 * np.count_nonzero(touching)
    assert np.count_nonzero(found & ~touching) < 0.02 * np.count_nonzero(shown < PRESS_M)


def test_errors_of_the_surface_hardly_change_the_touching_pixels(geometry):
    """Smooth errors of 10 um, which is what a good sensor has."""
    from scipy.ndimage import gaussian_filter

    shown = deform_gel(draw("block", geometry), PRESS_M, geometry)[0]
    error = gaussian_filter(np.random.default_rng(0).standard_normal(shown.shape), 3)
    noisy = np.clip(shown + 1e-5 * error / error.std(), 0, PRESS_M).astype(np.float32)
    clean, found = (find_touching(surface, PRESS_M, geometry) for surface in (shown, noisy))
    assert np.count_nonzero(clean & found) > 0.8 * np.count_nonzero(clean | found)


def test_a_touch_separates_what_touches_from_what_it_shows(geometry):
    depth = deform_gel(draw("sphere", geometry), PRESS_M, geometry)[0]
    elastic = Touch(ContactShape(depth, PRESS_M), geometry)
    rigid = Touch(ContactShape(depth, PRESS_M), dataclasses.replace(geometry, gel=Gel()))
    assert rigid.touching_shape is rigid.contact_shape
    touching, shown = elastic.touching_shape.contact, elastic.contact_shape.contact
    assert 0 < np.count_nonzero(touching) < 0.4 * np.count_nonzero(shown)
    assert not (touching & ~shown).any()
    np.testing.assert_array_equal(elastic.touching_shape.depth_m[touching], depth[touching])


def test_the_gel_beside_the_contact_shows_nothing_of_the_object(geometry):
    """A pixel is known if it touches, or if the gel there is deeper than the cut."""
    depth = deform_gel(draw("sphere", geometry), PRESS_M, geometry)[0]
    touch = Touch(ContactShape(depth, PRESS_M), geometry)
    known = touch.find_known(0.9 * PRESS_M)
    beside = ~touch.touching_shape.contact & (depth < 0.9 * PRESS_M)
    assert beside.any()
    np.testing.assert_array_equal(known, ~beside & geometry.observed_mask)


PITCH_M, PX, PRESS_M = 1.5e-4, 128, 5e-4
COATED = Gel(5e-3, 0.48, 3e-4)
SCALE = 1 / PITCH_M
GEOMETRY = SensorGeometry(
    "orthographic", PX, PX, SCALE, SCALE, PX / 2, PX / 2, standoff_m=0.01, max_depth_m=1.5e-3, gel=COATED
)
x_m = PITCH_M * (np.arange(PX) + 0.5 - PX / 2)
X, Y = np.meshgrid(x_m, x_m)
R = np.hypot(X, Y)
HEIGHTS = {
    "sphere": R**2 / 6e-3,
    "punch": np.where((np.abs(X) < 2.5e-3) & (np.abs(Y) < 1.5e-3), 0.0, 1.0),
    "ridge": 0.6 * np.abs(0.8 * X + 0.6 * Y) + np.maximum(np.abs(0.8 * Y - 0.6 * X) - 3e-3, 0),
    "cone": 0.8 * R,
}


def press(name: str) -> tuple[np.ndarray, np.ndarray]:
    """The displacement of the gel's surface, and of its coating's underside (H, W), metres, solved at every pixel."""
    solver = make_solver(Gel(COATED.thickness_m, COATED.poisson), (PX, PX), (PITCH_M, PITCH_M))
    found = solver.press((PRESS_M - HEIGHTS[name])[None].astype(np.float32), 60)
    q = np.hypot(*list_wave_numbers(solver.padded, (PITCH_M, PITCH_M)))
    spectrum = np.fft.rfft2(found.pressure[0], solver.padded) * solver.compliance * compute_smoothing(q, COATED)
    return found.displacement_m[0], np.fft.irfft2(spectrum, solver.padded)[:PX, :PX]


def recover(seen_m: np.ndarray, geometry: SensorGeometry = GEOMETRY, noise: float = 0.0):
    slopes = differentiate(seen_m, geometry) + noise * np.random.default_rng(0).standard_normal((PX, PX, 2))
    return recover_contact(slopes.astype(np.float32), seen_m > 0.2 * seen_m.max(), geometry)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize(("name", "most_m"), [("sphere", 3e-6), ("punch", 9e-6), ("ridge", 9e-6), ("cone", 3e-6)])
def test_the_surface_under_the_coating_is_recovered(name, most_m, noise):
    surface_m, seen_m = press(name)
    found = recover(seen_m, noise=noise)
    assert rms(found.displacement_m - surface_m) < most_m
    assert rms(seen_m - surface_m) > 1.3 * rms(found.displacement_m - surface_m)


def test_the_absolute_level_follows_from_the_slopes_alone():
    """Slopes do not change if the surface is shifted, so the level comes from contact mechanics."""
    surface_m, seen_m = press("sphere")
    slopes = differentiate(seen_m + 1e-3, GEOMETRY).astype(np.float32)
    found = recover_contact(slopes, seen_m > 1e-4, GEOMETRY)
    assert found.displacement_m.max() == pytest.approx(surface_m.max(), rel=0.02)


def test_pressures_push_and_only_candidates_touch():
    _, seen_m = press("punch")
    candidates = (X > 0) & (seen_m > 1e-4)
    found = recover_contact(differentiate(seen_m, GEOMETRY).astype(np.float32), candidates, GEOMETRY)
    assert (found.pressure >= 0).all()
    assert found.pressure[candidates].any()
    assert not found.pressure[~candidates].any()


def test_unobserved_slopes_do_not_matter():
    surface_m, seen_m = press("sphere")
    observed = X < 3.5e-3
    masked = dataclasses.replace(GEOMETRY, observed=observed)
    slopes = differentiate(seen_m, GEOMETRY).astype(np.float32)
    wrong = np.where(observed[..., None], slopes, np.float32(0.7))
    found = [recover_contact(one, (seen_m > 1e-4) & observed, masked).displacement_m for one in (slopes, wrong)]
    np.testing.assert_array_equal(*found)
    assert rms((found[0] - surface_m)[observed]) < 8e-6


def test_no_slopes_are_no_contact():
    found = recover_contact(np.zeros((PX, PX, 2), np.float32), np.ones((PX, PX), bool), GEOMETRY)
    assert not found.displacement_m.any()
    assert not found.pressure.any()


def test_a_coating_smooths_as_boussinesq_says():
    """The displacement at a depth under a point force, transformed numerically (Johnson 1985, equation 3.19)."""
    from scipy.integrate import quad
    from scipy.special import j0

    gel = Gel(math.inf, 0.4, 4e-4)
    z = gel.coating_m

    def displace(r: float) -> float:  # times the shear modulus, under a unit force
        away = math.hypot(r, z)
        return (z**2 / away**3 + 2 * (1 - gel.poisson) / away) / (4 * math.pi)

    for q in (500.0, 2000.0, 6000.0):
        # the far part, in which the kernel is that of the surface, is known in closed form
        near = quad(
            lambda r, q=q: (displace(r) - (1 - gel.poisson) / (2 * math.pi * math.hypot(r, z))) * j0(q * r) * r,
            0,
            40 * z,
            limit=2000,
        )[0]
        whole = 2 * math.pi * near + (1 - gel.poisson) * math.exp(-q * z) / q
        surface = compute_compliance(np.array([q]), Gel(1e3, gel.poisson))[0]
        assert whole / surface == pytest.approx(float(compute_smoothing(np.array([q]), gel)[0]), rel=0.02)
