import sys

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.plugin import MissingLibraryError, registry
from tactile_loc.plugin.helpers import Cloud, make_transform, make_translation, rotation_about, transform_points

pytest.importorskip("kiss_icp")

from tactile_loc.plugins.refiners.kiss import KissIcpRefiner, has_pairs

Options = KissIcpRefiner.Options


def steps(count: int = 40, spacing: float = 0.25) -> Cloud:
    """Two square terraces side by side on a lattice, 1 mm apart in height, as a sensor sees them."""
    x, y = (c.ravel() for c in np.meshgrid(np.arange(count) * spacing, np.arange(count) * spacing))
    points = np.column_stack([x, y, np.where(x + 0.3 * y > 6.0, 1.0, 0.0) + 0.02 * y**2])
    normals = np.column_stack([0 * y, 0.04 * y, -np.ones_like(y)])
    return Cloud(points, normals / np.linalg.norm(normals, axis=1, keepdims=True), spacing)


def moved(cloud: Cloud, T: np.ndarray) -> Cloud:
    return Cloud(transform_points(T, cloud.points_mm), cloud.normals @ T[:3, :3].T, cloud.spacing_mm)


def scaled(cloud: Cloud, k: float) -> Cloud:
    return Cloud(k * cloud.points_mm, cloud.normals, k * cloud.spacing_mm)


MOTION = make_transform(rotation_about([0.2, 0.1, 1.0], 0.05), [0.9, 0.7, 0.1])


@pytest.mark.parametrize("k", [1e-3, 2.0, 50.0])
def test_the_registration_does_not_depend_on_the_unit(k):
    """Clouds and options in metres, in half millimetres, or as large as a car: the same answer, in that unit."""
    burst = {"max_iterations": 10}
    reach = {"wide_mm": 3.0, "narrow_mm": 0.7}
    plain = KissIcpRefiner(Options(**reach, **burst))
    other = KissIcpRefiner(Options(**{name: k * mm for name, mm in reach.items()}, **burst))
    source, target = moved(steps(), MOTION), steps()
    one, two = plain.register(source, target).T_mm, other.register(scaled(source, k), scaled(target, k)).T_mm
    np.testing.assert_allclose(two[:3, :3], one[:3, :3], atol=2e-4)
    np.testing.assert_allclose(two[:3, 3] / k, one[:3, 3], atol=2e-3)


def test_the_pixel_lattices_of_two_images_do_not_lock():
    """A shift by a whole pixel is undone, although each point then lies on another point."""
    shift = make_translation([0.5, 0.0, 0.0])
    found = KissIcpRefiner().register(moved(steps(), shift), steps())
    assert abs(found.T_mm[0, 3] + 0.5) < 0.15


def test_clouds_out_of_reach_are_not_registered():
    found = KissIcpRefiner().register(moved(steps(), make_translation([0, 0, 50.0])), steps())
    assert (found.T_mm, found.converged, found.iterations) == (None, False, 0)
    assert not has_pairs(steps().points_mm, steps(), make_translation([0, 0, 3.0]), 1.0)
    assert has_pairs(steps().points_mm, steps(), make_translation([0, 0, 3.0]), 5.0)


def test_few_iterations_do_not_claim_to_have_converged():
    found = KissIcpRefiner(Options(max_iterations=1)).register(moved(steps(), MOTION), steps())
    assert found.T_mm is not None
    assert (found.converged, found.iterations) == (False, 2)


def test_a_missing_library_gives_an_error_with_the_package_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_icp", None)
    monkeypatch.setitem(sys.modules, "kiss_icp.mapping", None)
    monkeypatch.delitem(sys.modules, "tactile_loc.plugins.refiners.kiss")
    registry.cache_clear()  # another test may have loaded the refiner
    with pytest.raises(MissingLibraryError, match=naming("'kiss-icp'", "pip install 'tactile-loc[kiss]'")):
        registry().create("refiner", "kiss-icp")
