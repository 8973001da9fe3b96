"""The full product of a plan, its order, and the inputs of a row's key."""

import pytest
import trimesh

from tactile_loc import Plan
from tactile_loc.core.runtime.errors import ConfigError, ObjectError, SensorError, UnknownPluginError
from tactile_loc.evaluation.sweep import combination as module
from tactile_loc.evaluation.sweep.combination import combine, order_for_running


def keys(values: dict) -> list[str]:
    return [one.key for one in combine(Plan.from_values(values))[0]]


def test_all_values_are_combined_in_the_plans_order():
    values = {"object": ["pin", "head"], "refiner": ["none", "icp"], "noise": ["none", "strong"], "seed": [0, 5]}
    found, objects = combine(Plan.from_values(values))
    told = [(one.object, one.config.refiner.name, one.config.touch.noise, one.config.seed) for one in found]
    assert told == [
        (o, r, n, s) for o in ("pin", "head") for r in ("none", "icp") for n in ("none", "strong") for s in (0, 5)
    ]
    assert set(objects) == {"pin", "head"}
    assert len({one.key for one in found}) == len(found)


def test_consecutive_jobs_share_few_stages():
    values = {
        "object": ["pin", "head"],
        "encoder": ["pixel"],
        "refiner": ["none", "icp"],
        "option": ["encoder.cells=9,12"],
    }
    found = order_for_running(combine(Plan.from_values(values))[0])
    told = [(one.config.refiner.name, one.config.encoder.options["cells"], one.object) for one in found]
    assert told == [(r, c, o) for r in ("none", "icp") for c in (9, 12) for o in ("pin", "head")]


def test_equal_inputs_give_equal_keys_and_any_change_gives_another_key(monkeypatch):
    base = {"object": ["pin"], "refiner": ["icp"], "noise": ["none"], "seed": [0], "count": 4}
    (key,) = keys(base)
    assert keys({**base, "refiner": [{"name": "icp", "max_iterations": 20}]}) == [key]  # the default
    single = {"noise": ["mild"], "seed": [1], "count": 5, "shape_px": 32, "temperature": 0.1}
    changes = [
        *({"object": [one]} for one in ("head", {"path": "pin", "symmetry": "none"})),
        *({"refiner": [one]} for one in ("none", {"name": "icp", "max_iterations": 7})),
        *({name: value} for name, value in single.items()),
    ]
    others = [keys({**base, **change})[0] for change in changes]
    assert len({key, *others}) == 1 + len(changes)
    for name, value in (("PROTOCOL_VERSION", 99), ("version", lambda _: "99.0"), ("ROW_VERSION", 99)):
        with monkeypatch.context() as patched:
            patched.setattr(module, name, value)
            assert keys(base) != [key]


def test_the_key_depends_on_the_content_of_a_mesh_and_not_on_its_path(tmp_path):
    for folder, side in (("a", 20), ("b", 20), ("c", 21)):
        (tmp_path / folder).mkdir()
        trimesh.creation.box((side, 15, 10)).export(tmp_path / folder / "part.stl")
    a, b, c = (keys({"object": [{"path": str(tmp_path / f / "part.stl"), "units": "mm"}]}) for f in "abc")
    assert a == b != c


def test_a_component_with_other_code_makes_another_row(monkeypatch):
    before = keys({"object": ["pin"], "refiner": ["icp"]})
    monkeypatch.setattr("tactile_loc.slots.component.hash_component", lambda kind: "changed")
    assert keys({"object": ["pin"], "refiner": ["icp"]}) != before


@pytest.mark.parametrize(
    ("values", "kind", "said"),
    [
        ({"object": ["hok"]}, ObjectError, "hok"),
        ({"object": ["pin", {"path": "pin", "symmetry": "none"}]}, ConfigError, "pin"),
        ({"object": ["pin"], "grid": ["face", "whole"]}, ConfigError, r"'whole'.*face"),
        ({"object": ["pin"], "sensor": ["none.toml"]}, SensorError, r"none\.toml"),
        ({"object": ["pin"], "sensor": ["gelslm"]}, UnknownPluginError, "gelslm"),
    ],
)
def test_impossible_combinations_are_refused(values, kind, said):
    with pytest.raises(kind, match=said):
        combine(Plan.from_values(values))
