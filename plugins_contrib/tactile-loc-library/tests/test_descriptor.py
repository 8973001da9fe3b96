"""Tests of the descriptor: another implementation of its networks, yaws, and touches drawn exactly."""

from importlib.resources import files

import numpy as np
import pytest
from safetensors.numpy import load, save
from tactile_loc import ObjectModel, RobotTouches, load_object
from tactile_loc.core.places.places import BELOW, FAR, STEP_M
from tactile_loc.plugin import Places, Progress, Touch, registry
from tactile_loc.plugin.helpers import PATCH_PX, find_anchor

from tactile_loc_library.descriptor import (
    ANGLES,
    RAMPS_M,
    WEIGHTS,
    Descriptor,
    encode_places,
    encode_touch,
    load_descriptor,
)

DIRECTIONS = 400


@pytest.fixture(scope="module")
def places() -> dict[str, Places]:
    grid = registry().create("grid", "whole", {"directions": DIRECTIONS})
    return {name: grid.places(load_object(name), Progress()) for name in ("pin", "hook", "cotter")}


def test_networks_compute_what_torch_computes(places: dict[str, Places]) -> None:
    torch = pytest.importorskip("torch")
    from safetensors.torch import load as load_tensors

    weights = {k: v.float() for k, v in load_tensors((files("tactile_loc_library") / WEIGHTS).read_bytes()).items()}
    patches = places["hook"].patches[:50]
    x = torch.from_numpy(encode_places(patches)).transpose(1, 2)
    for k, stride in enumerate((1, 2, 2)):
        x = torch.nn.functional.pad(x, (2, 2), mode="circular")
        x = torch.relu(torch.conv1d(x, weights[f"keys.{k}.weight"], weights[f"keys.{k}.bias"], stride=stride))
    pooled = torch.cat([x.mean(dim=2), x.amax(dim=2)], dim=1)
    vectors = pooled @ weights["keys.out.weight"].T + weights["keys.out.bias"]
    expected = torch.nn.functional.normalize(vectors, dim=1).numpy()
    np.testing.assert_allclose(load_descriptor().describe_places(patches), expected, atol=1e-5)


def test_digest_identifies_only_the_network_of_places() -> None:
    weights = load(content := (files("tactile_loc_library") / WEIGHTS).read_bytes())
    own = Descriptor(content).digest
    touches = {name: array + array.dtype.type(name == "queries.0.bias") for name, array in weights.items()}
    places = {name: array + array.dtype.type(name == "keys.0.bias") for name, array in weights.items()}
    assert Descriptor(save(touches)).digest == own == load_descriptor().digest
    assert Descriptor(save(places)).digest != own


def test_a_quarter_turn_hardly_changes_the_vector(places: dict[str, Places]) -> None:
    patches = places["cotter"].patches
    turned = np.ascontiguousarray(np.rot90(patches, axes=(1, 2)))
    similarity = (load_descriptor().describe_places(patches) * load_descriptor().describe_places(turned)).sum(axis=1)
    assert similarity.min() > 0.99  # 48 angles and a stride of four divide a quarter turn


def test_features_of_a_plane_and_of_a_step() -> None:
    flat = np.full((1, PATCH_PX, PATCH_PX), BELOW, np.uint8)
    assert not encode_places(flat).any()
    half = flat.copy()
    half[:, :, PATCH_PX // 2 + 4 :] = FAR
    features = encode_places(half).reshape(ANGLES, len(RAMPS_M), -1)
    assert features[0, :, -1].tolist() == [1] * len(RAMPS_M)  # along +x, far from the place
    assert not features[ANGLES // 2].any()  # along -x


def test_features_of_a_touch_state_what_is_known() -> None:
    press_m = 3e-4
    depth = np.full((1, PATCH_PX, PATCH_PX), press_m, np.float32)
    depth[:, :, : PATCH_PX // 2 + 1] = 10 * STEP_M
    seen = np.ones_like(depth, bool)
    seen[:, :10] = False
    values, known = np.split(encode_touch(depth, seen, press_m).reshape(ANGLES, 2, len(RAMPS_M), -1), 2, axis=1)
    values, known = values[:, 0], known[:, 0]
    assert known[ANGLES // 2].all()  # contact: every ramp is known
    assert known[0, :, -1].tolist() == [1, 1, 0, 0]  # beside the contact, up to the press
    assert not known[3 * ANGLES // 4, :, -1].any()  # not seen
    assert not values[3 * ANGLES // 4, :, -1].any()
    np.testing.assert_allclose(values[0, :2, -1], 1)


@pytest.mark.parametrize("name", ["pin", "hook", "cotter"])
def test_touches_resemble_a_place_of_their_object_nearby(places: dict[str, Places], name: str) -> None:
    geometry = registry().create("sensor", "gelsight-mini", {}).geometry
    obj, descriptor = load_object(name), load_descriptor()
    source = RobotTouches(obj, geometry, registry().create("renderer", "zbuffer", {}))
    own = descriptor.describe_places(places[name].patches)
    ranks = []
    for touch in source.draw_example(8, np.random.default_rng(3))[0]:
        similar = own @ descriptor.describe_touch(touch)
        near = _measure_off_m(places[name], touch, obj) < 3e-3
        ranks.append((similar > similar[near].max()).mean())
    assert np.median(ranks) < 0.05


def _measure_off_m(places: Places, touch: Touch, obj: ObjectModel) -> np.ndarray:
    """Return the distances (N,), metres, of a touch's deepest point from the places, up to the object's symmetry."""
    T, T_base_sensor = places.T_place_object, touch.T_base_sensor
    assert T_base_sensor is not None
    anchor_m = T_base_sensor[:3, :3] @ find_anchor(touch)[0] + T_base_sensor[:3, 3]
    at_m = -np.einsum("nij,ni->nj", T[:, :3, :3], T[:, :3, 3])
    alike_m = [S[:3, :3] @ anchor_m + S[:3, 3] for S in obj.symmetry.list_elements(max_step_rad=0.05)]
    return np.min([np.linalg.norm(at_m - one_m, axis=1) for one_m in alike_m], axis=0)
