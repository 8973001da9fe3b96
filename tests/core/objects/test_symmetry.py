import math

import numpy as np
import pytest
from message_helpers import naming
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tactile_loc.core.runtime.errors import SymmetryError
from tactile_loc.plugin.helpers import SymmetryGroup, rotation_angle

CENTRE_M = (0.01, -0.02, 0.03)
ORDERS = {
    "none": 1,
    "z2": 2,
    "z6": 6,
    "x2*y2": 4,
    "z4*x2": 8,
    "z6*x2": 12,
    "axis(1,1,1)3*z2": 12,
    "x4*y4": 24,
    "axis(0,1,1.6180339887)5*axis(1,1,1)3": 60,
    "z60*x2": 120,
}


def random_rotations(count: int, seed: int = 1) -> NDArray[np.float64]:
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix()


@pytest.mark.parametrize(("text", "order"), [*ORDERS.items(), ("axis(0.577,0.577,0.578)3*z2", 12)])
def test_the_closure_has_the_order_of_the_group(text: str, order: int) -> None:
    group = SymmetryGroup.parse(text, CENTRE_M)
    assert group.order == order
    assert group.is_trivial == (text == "none")
    np.testing.assert_allclose(group.rotations[0], np.eye(3))
    np.testing.assert_allclose(np.linalg.det(group.rotations), 1.0)


@pytest.mark.parametrize("text", [*list(ORDERS)[:-1], "zinf", "zinf*x2", "axis(1,1,0)inf*z2", "sphere"])
def test_the_elements_are_closed_under_product_and_inverse(text: str) -> None:
    T = SymmetryGroup.parse(text, CENTRE_M).list_elements(math.radians(36.0))
    products = (T[:, None] @ T[None]).reshape(-1, 16)
    candidates = np.concatenate([products, np.linalg.inv(T).reshape(-1, 16)])
    difference = np.abs(candidates[:, None] - T.reshape(-1, 16)[None]).max(axis=2)
    assert difference.min(axis=1).max() < 1e-6
    assert np.sum(difference[: len(T) ** 2] < 1e-6) == len(T) ** 2, "every product is exactly one element"


@pytest.mark.parametrize("text", ["none", "z6*x2", "zinf*x2", "x2*y2", "axis(0.58,0.58,0.58)3", "axis(1,-1,0.25)inf"])
def test_parsing_and_writing_keep_the_text(text: str) -> None:
    assert str(SymmetryGroup.parse(text, CENTRE_M)) == text
    assert str(SymmetryGroup.parse(f" {text.upper()} ".replace("*", " * "), CENTRE_M)) == text


@pytest.mark.parametrize("text", ["sphere", "zinf*xinf", "zinf*x4", "zinf*axis(1,0,1)2", "axis(1,2,3)inf*z2"])
def test_two_axes_of_which_one_is_continuous_make_a_sphere(text: str) -> None:
    group = SymmetryGroup.parse(text, CENTRE_M)
    assert str(group) == "sphere"
    assert group.order == math.inf
    assert not SymmetryGroup.parse("zinf*x2", CENTRE_M).is_sphere


def test_all_rotations_of_a_sphere_are_equal() -> None:
    group, R = SymmetryGroup.parse("sphere", CENTRE_M), random_rotations(50)
    assert not group.measure_least_angle(R[0], R).any()
    assert group.is_representative(R, 0.1).sum() == 1
    T = group.list_elements()
    np.testing.assert_allclose(T[:, :3, :3] @ CENTRE_M + T[:, :3, 3], np.tile(CENTRE_M, (60, 1)), atol=1e-15)


@pytest.mark.parametrize(("step_deg", "count"), [(10.0, 36), (7.0, 52), (100.0, 4), (360.0, 2)])
def test_a_continuous_axis_is_sampled_evenly_within_the_step(step_deg: float, count: int) -> None:
    T = SymmetryGroup.parse("zinf", CENTRE_M).list_elements(math.radians(step_deg))
    angle_rad = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    np.testing.assert_allclose(angle_rad, np.arange(count) * 2.0 * math.pi / count, atol=1e-12)
    assert SymmetryGroup.parse("zinf", CENTRE_M).order == math.inf


def test_terms_along_a_continuous_axis_are_merged() -> None:
    assert len(SymmetryGroup.parse("zinf*z6", CENTRE_M).list_elements(math.pi)) == 2
    assert len(SymmetryGroup.parse("x2*zinf*y2", CENTRE_M).list_elements(math.pi)) == 4


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", "axis(1,1,0)2"),
        ("z", "axis(1,1,0)2"),
        ("w3", "axis(1,1,0)2"),
        ("z6*", "axis(1,1,0)2"),
        ("axis(1,1)2", "axis(1,1,0)2"),
        ("axis(0,0,0)2", "axis(1,1,0)2"),
        ("axis(nan,0,1)2", "axis(1,1,0)2"),
        ("z-2", "axis(1,1,0)2"),
        ("z1", "order"),
        ("z0", "order"),
        ("z7*x3", 120),
        ("z121", 120),
        ("axis(1,2,3)2*z4", 120),
    ],
)
def test_an_invalid_group_is_refused_by_name(text: str, value: object) -> None:
    with pytest.raises(SymmetryError, match=naming(f"'{text}'", value)):
        SymmetryGroup.parse(text, CENTRE_M)


@pytest.mark.parametrize("centre_m", [(0.0, 0.0), (0.0, 0.0, math.nan)])
def test_a_centre_requires_three_finite_numbers(centre_m: tuple[float, ...]) -> None:
    with pytest.raises(SymmetryError, match="centre"):
        SymmetryGroup.parse("z2", centre_m)


def test_sampling_steps_must_be_positive() -> None:
    group = SymmetryGroup.parse("zinf", CENTRE_M)
    with pytest.raises(SymmetryError, match=naming("0.0 rad")):
        group.list_elements(0.0)
    with pytest.raises(SymmetryError, match="step_rad"):
        group.is_representative(random_rotations(3))


@pytest.mark.parametrize("text", ORDERS)
def test_every_rotation_has_exactly_one_representative(text: str) -> None:
    group = SymmetryGroup.parse(text, CENTRE_M)
    orbits = random_rotations(200)[:, None] @ group.rotations[None]
    kept = group.is_representative(orbits.reshape(-1, 3, 3)).reshape(200, -1)
    np.testing.assert_array_equal(kept.sum(axis=1), 1)


@pytest.mark.parametrize("text", ["zinf", "zinf*x2", "axis(1,2,3)inf"])
@pytest.mark.parametrize("count", [2, 36, 50])
def test_an_evenly_sampled_continuous_orbit_has_one_representative(text: str, count: int) -> None:
    group, step_rad = SymmetryGroup.parse(text, CENTRE_M), 2.0 * math.pi / count
    orbits = random_rotations(200)[:, None] @ group.list_elements(step_rad)[None, :, :3, :3]
    kept = group.is_representative(orbits.reshape(-1, 3, 3), step_rad).reshape(200, -1)
    np.testing.assert_array_equal(kept.sum(axis=1), 1)


@pytest.mark.parametrize("text", ["none", "z6", "x2*y2", "zinf", "axis(1,1,0)inf*z2"])
def test_the_least_angle_is_measured_to_the_nearest_equivalent(text):
    group = SymmetryGroup.parse(text, [0.01, 0, 0])
    R = random_rotations(30)
    same = R[:, None] @ group.list_elements(0.002)[:, :3, :3]
    expected = rotation_angle(R[0].T @ same).min(axis=1)
    np.testing.assert_allclose(group.measure_least_angle(R[0], R), expected, atol=2e-3 if "inf" in text else 1e-7)
