"""The contact recovered from seen slopes, compared with formulas and with an independent solver."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import SensorError
from tactile_loc.core.sensing.gel import Gel, compute_compliance, compute_smoothing, list_wave_numbers, make_solver
from tactile_loc.core.sensing.gel_inverse import recover_contact
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.reading.surface import differentiate

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


def test_a_sharp_tip_becomes_deeper_than_it_looks():
    surface_m, seen_m = press("cone")
    found_m = recover(seen_m).displacement_m
    assert seen_m.max() < 0.7 * surface_m.max()
    assert found_m.max() > 0.85 * surface_m.max()


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


def test_the_pressure_of_a_flat_punch_is_largest_at_its_edge():
    found = recover(press("punch")[1]).pressure
    inside, rim = (np.abs(X) < 1.2e-3) & (np.abs(Y) < 7e-4), (np.abs(X) < 2.5e-3) & (np.abs(np.abs(Y) - 1.4e-3) < 2e-4)
    assert np.median(found[rim]) > 1.5 * np.median(found[inside])


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


def test_an_independent_solver_agrees():
    """ContactMechanics presses a sphere into a half-space without coating."""
    mechanics = pytest.importorskip("ContactMechanics")
    systems = pytest.importorskip("ContactMechanics.Systems")
    topography = pytest.importorskip("SurfaceTopography")
    side = PX * PITCH_M
    system = systems.NonSmoothContactSystem(
        mechanics.FreeFFTElasticHalfSpace((PX, PX), 1.0, (side, side)),
        topography.Topography(np.maximum(PRESS_M - HEIGHTS["sphere"], -0.05), (side, side)),
    )
    assert system.minimize_proxy(offset=0.0, pentol=1e-8, maxiter=500).success
    surface_m = system.disp[:PX, :PX]
    found = recover(surface_m, dataclasses.replace(GEOMETRY, gel=Gel(math.inf, 0.48)))
    assert rms(found.displacement_m - surface_m) < 0.01 * PRESS_M


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
            0, 40 * z, limit=2000,
        )[0]  # fmt: skip
        whole = 2 * math.pi * near + (1 - gel.poisson) * math.exp(-q * z) / q
        surface = compute_compliance(np.array([q]), Gel(1e3, gel.poisson))[0]
        assert whole / surface == pytest.approx(float(compute_smoothing(np.array([q]), gel)[0]), rel=0.02)


def test_a_coating_is_part_of_the_gel():
    assert Gel.of_description(COATED.describe()) == COATED
    assert "coating_m" not in Gel(4e-3).describe()
    with pytest.raises(SensorError):
        Gel(1e-3, coating_m=2e-3)
    with pytest.raises(SensorError):
        Gel(4e-3, coating_m=-1e-4)
