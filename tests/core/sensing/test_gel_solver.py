"""The gel's mechanics, compared with formulas and with independent solvers."""

import math

import numpy as np
import pytest

from tactile_loc.core.runtime.errors import SensorError
from tactile_loc.core.sensing.gel import RIGID, Gel, compute_compliance, make_solver

PX, PITCH_M, PRESS_M = 64, 2e-4, 5e-4
LAYER, HALF_SPACE = Gel(4e-3, 0.48), Gel(math.inf, 0.45)
x_m = PITCH_M * (np.arange(PX) - (PX - 1) / 2)
X, Y = np.meshgrid(x_m, x_m)
R = np.hypot(X, Y)


def reach(height_m):
    """The reach (1, H, W), metres, of an object whose surface is `height_m` (H, W) above its deepest point."""
    return np.where(height_m < PRESS_M, PRESS_M - height_m, -np.inf)[None].astype(np.float32)


def sphere(radius_m=3e-3):
    return reach(radius_m - np.sqrt(np.maximum(radius_m**2 - R**2, 0)))


def punch(radius_m):
    return reach(np.where(radius_m > R, 0.0, 1.0))


def cone(slope):
    return reach(slope * R)


def block():
    """A block that is tilted by eight degrees."""
    inside = (np.abs(X) < 3e-3) & (np.abs(Y) < 2e-3)
    return reach(np.where(inside, (X + 3e-3) * np.tan(np.radians(8)), 1.0))


SHAPES = {"sphere": sphere(), "punch": punch(2e-3), "cone": cone(1.0), "block": block()}


def solver(gel):
    return make_solver(gel, (PX, PX), (PITCH_M, PITCH_M))


def rms_m(a, b):
    return float(np.sqrt(np.mean((a - b) ** 2)))


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("gel", [LAYER, Gel(1.5e-3, 0.4), HALF_SPACE], ids=["layer", "thin layer", "half-space"])
def test_contact_satisfies_its_conditions(name, gel):
    """The gel is at or beyond the object, no pressure is negative, and there is pressure only at the object."""
    d = SHAPES[name]
    u, p = solver(gel).press(d, 60)
    assert (p >= 0).all()
    assert (u - d)[np.isfinite(d)].min() > -2e-3 * PRESS_M
    assert np.abs((u - d)[p > 0]).max() < 2e-3 * PRESS_M


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("gel", [LAYER, HALF_SPACE], ids=["layer", "half-space"])
def test_contact_agrees_with_contact_mechanics(name, gel):
    """ContactMechanics solves the same problem, for the same window and padding."""
    systems = pytest.importorskip("ContactMechanics.Systems")
    mechanics = pytest.importorskip("ContactMechanics")
    topography = pytest.importorskip("SurfaceTopography").Topography
    ours, mm = solver(gel), 1e3
    if math.isinf(gel.thickness_m):
        young, size_px = 2 * (1 + gel.poisson) / (1 - gel.poisson**2), PX
        substrate = mechanics.FreeFFTElasticHalfSpace((PX, PX), young, (PX * PITCH_M * mm,) * 2)
    else:
        young, size_px = 2 * (1 + gel.poisson), ours.padded[0]
        substrate = mechanics.PeriodicFFTElasticHalfSpace(
            (size_px, size_px),
            young,
            (size_px * PITCH_M * mm,) * 2,
            thickness=gel.thickness_m * mm,
            poisson=gel.poisson,
        )
    heights_mm = np.full((size_px, size_px), -50.0)
    heights_mm[:PX, :PX] = np.where(np.isfinite(SHAPES[name][0]), SHAPES[name][0] * mm, -50.0)
    system = systems.NonSmoothContactSystem(substrate, topography(heights_mm, (size_px * PITCH_M * mm,) * 2))
    assert system.minimize_proxy(offset=0.0, pentol=1e-6, maxiter=1000).success
    theirs_m, force = system.disp[:PX, :PX] / mm, np.abs(system.force[:PX, :PX])
    u, p = ours.press(SHAPES[name], 100)
    assert np.abs(u[0] - theirs_m).max() < 0.01 * PRESS_M
    assert np.count_nonzero(p) == pytest.approx(np.count_nonzero(force > 1e-9), rel=0.03)


def test_a_sphere_on_a_half_space_obeys_hertz():
    """Hertz: the contact's radius is sqrt(R d), and the greatest pressure is 2 E* sqrt(d / R) / pi."""
    radius_m = 8e-3
    p = solver(HALF_SPACE).press(sphere(radius_m), 60).pressure[0]
    area_m2 = np.count_nonzero(p) * PITCH_M**2
    assert math.sqrt(area_m2 / math.pi) == pytest.approx(math.sqrt(radius_m * PRESS_M), rel=0.03)
    modulus = 2 / (1 - HALF_SPACE.poisson)  # E* = E / (1 - nu^2), in units of the shear modulus
    assert p.max() == pytest.approx(2 / math.pi * modulus * math.sqrt(PRESS_M / radius_m), rel=0.03)


@pytest.mark.parametrize("thickness_m", [2e-3, 4e-3, 14e-3, 0.1])
def test_a_contact_does_not_depend_on_the_window(thickness_m):
    """A window of four times the side has the same contact in its middle."""
    gel, beside = Gel(thickness_m), 3 * PX // 2
    wide = np.pad(SHAPES["block"], ((0, 0), (beside, beside), (beside, beside)), constant_values=-np.inf)
    in_wide = make_solver(gel, wide.shape[1:], (PITCH_M, PITCH_M)).press(wide, 30).displacement_m
    in_narrow = solver(gel).press(SHAPES["block"], 30).displacement_m
    assert rms_m(in_narrow, in_wide[:, beside:-beside, beside:-beside]) < 1e-4 * PRESS_M


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.48])
def test_a_layer_yields_to_a_uniform_pressure_as_its_compliance_says(poisson):
    """The displacements around one pixel sum to the compliance at the wave number 0."""
    gel = Gel(1.5e-3, poisson)
    total = make_solver(gel, (160, 160), (PITCH_M, PITCH_M)).compliance[0, 0]
    assert total == pytest.approx(compute_compliance(np.zeros(1), gel)[0], rel=0.02)


def test_a_very_thin_compressible_layer_is_an_elastic_foundation():
    """Winkler: the layer yields by t (1 - 2 nu) / (2 (1 - nu)) for each unit of pressure, and only under the object."""
    thin = Gel(2e-4, 0.2)
    q = 2 * np.pi / np.array([0.02, 0.05])
    np.testing.assert_allclose(compute_compliance(q, thin), 2e-4 * 0.6 / 1.6, rtol=0.01)
    coarse = make_solver(thin, (PX, PX), (1e-3, 1e-3))
    u = coarse.press(punch(2e-3), 60).displacement_m[0]
    assert np.abs(u[punch(2e-3)[0] < 0]).max() < 0.03 * PRESS_M


@pytest.mark.parametrize("name", SHAPES)
def test_three_iterations_are_nearly_converged(name):
    converged = solver(LAYER).press(SHAPES[name], 100).displacement_m
    rigid = np.maximum(SHAPES[name], 0)
    fast = solver(LAYER).press(SHAPES[name]).displacement_m
    assert rms_m(fast, converged) < 5e-6
    assert rms_m(fast, converged) < 0.15 * rms_m(rigid, converged)


def test_objects_are_solved_independently():
    both = solver(LAYER).press(np.concatenate([SHAPES["sphere"], SHAPES["block"]]))
    alone = solver(LAYER).press(SHAPES["block"])
    np.testing.assert_allclose(both.displacement_m[1], alone.displacement_m[0], atol=1e-8)


def test_a_rigid_gel_has_no_solver():
    with pytest.raises(SensorError):
        make_solver(RIGID, (8, 8), (1e-3, 1e-3))


def test_compliance_is_continuous_at_small_wave_numbers_and_that_of_a_half_space_for_a_thick_layer():
    q = np.array([0.0, 1e-4, 1e-2, 1.0, 5.0])
    np.testing.assert_allclose(compute_compliance(q, LAYER), compute_compliance(q, LAYER)[0], rtol=1e-2)
    q = 2 * np.pi / np.array([1e-4, 1e-3, 5e-3])
    np.testing.assert_allclose(compute_compliance(q, Gel(0.1, 0.45)), (1 - 0.45) / q, rtol=1e-6)


IMPOSSIBLE = [
    (0.0, 0.4),
    (-1.0, 0.4),
    (math.nan, 0.4),
    (4e-3, 0.5),
    (4e-3, -0.1),
    (1e-3, 0.4, 2e-3),
    (4e-3, 0.4, -1e-4),
]


@pytest.mark.parametrize("numbers", IMPOSSIBLE)
def test_impossible_gels_are_refused(numbers):
    with pytest.raises(SensorError):
        Gel(*numbers)


def test_gels_have_different_descriptions():
    gels = [RIGID, LAYER, HALF_SPACE, Gel(4e-3, 0.4), Gel(3e-3, 0.48), Gel(4e-3, 0.48, 3e-4)]
    assert len({str(gel.describe()) for gel in gels}) == len(gels)
    assert [Gel.of_description(gel.describe()) for gel in gels] == gels
    assert "coating_m" not in LAYER.describe()
