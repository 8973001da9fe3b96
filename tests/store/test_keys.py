import hashlib
import math
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.store.keys import StageKey, hash_arrays, hash_file, hash_json, hash_shortly, write_canonical_json


def test_the_digest_is_that_of_the_canonical_json():
    text = '{"inputs":{"a":[1,0.1,null,true],"b":{"x":"\\u00e9"}},"stage":"grid","version":3}'
    key = StageKey("grid", 3, {"b": {"x": "é"}, "a": (1, 0.1, None, True)})
    assert key.digest == hashlib.sha256(text.encode()).hexdigest()
    assert key.short == key.digest[:16]
    values = {"stage": "grid", "version": 3, "inputs": key.inputs}
    assert (hash_json(values), hash_shortly(values)) == (key.digest, key.short)
    assert write_canonical_json({"a": np.float64(0.1)}) == write_canonical_json({"a": 0.1}) == '{"a":0.1}'


@pytest.mark.parametrize(
    "other",
    [
        StageKey("bank", 1, {"a": 1, "b": [0.1, 2]}),
        StageKey("grid", 2, {"a": 1, "b": [0.1, 2]}),
        StageKey("grid", 1, {"a": 2, "b": [0.1, 2]}),
        StageKey("grid", 1, {"a": 1, "b": [2, 0.1]}),
        StageKey("grid", 1, {"a": 1, "b": [math.nextafter(0.1, 1), 2]}),
        StageKey("grid", 1, {"a": "1", "b": [0.1, 2]}),
        StageKey("grid", 1, {"a": True, "b": [0.1, 2]}),
        StageKey("grid", 1, {"a": 1, "b": [0.1, 2], "c": None}),
    ],
)
def test_any_change_changes_the_digest(other):
    assert StageKey("grid", 1, {"a": 1, "b": [0.1, 2]}) != other


def test_neither_the_order_nor_a_later_change_of_the_inputs_changes_the_key():
    one = StageKey("grid", 1, {"a": 1, "b": {"c": 2.5, "d": [1, 2]}})
    other = StageKey("grid", 1, {"b": {"d": [1, 2], "c": 2.5}, "a": 1})
    assert one == other
    assert hash(one) == hash(other)
    options = {"steps": [1, 2]}
    key = StageKey("grid", 1, options)
    options["steps"].append(3)
    assert key.inputs == {"steps": [1, 2]}
    assert key == StageKey("grid", 1, {"steps": [1, 2]})


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (math.nan, "nan"),
        (math.inf, "inf"),
        (np.float64("nan"), "nan"),
        (np.int64(3), "numpy.int64"),
        (np.zeros(2), "numpy.ndarray"),
        (Path("x"), "Path"),
        ({1: 2}, "strings"),
    ],
)
def test_inputs_without_a_canonical_form_are_refused(value, says):
    with pytest.raises(StoreError, match=naming("'grid'", "['pose'][1]", says)):
        StageKey("grid", 1, {"pose": [0, value]})  # type: ignore[list-item]


@pytest.mark.parametrize("name", ["", "..", "a/b", "/etc", "grid\n"])
def test_stage_names_that_leave_the_store_are_refused(name):
    with pytest.raises(StoreError, match=naming(repr(name))):
        StageKey(name, 1, {})


def test_hash_arrays_sees_values_dtype_shape_and_name_but_no_layout():
    a, b = np.arange(6, dtype=np.float32).reshape(2, 3), np.arange(3)
    changed = a.copy()
    changed[1, 2] = np.nextafter(changed[1, 2], np.float32(9))
    others = [changed, a.reshape(3, 2), a.ravel(), a.astype(np.float64), a.view(np.int32), a.astype(">f4")]
    others += [np.zeros((0, 3)), np.zeros((3, 0)), np.array(1.0), np.array([1.0]), np.array(["a"])]
    others.append(np.array(["1970"], "M8[s]"))
    assert len({hash_arrays(a=a), hash_arrays(b=a), *(hash_arrays(a=other) for other in others)}) == 2 + len(others)
    assert len(hash_arrays(a=a)) == 64
    assert hash_arrays(a=a, b=b) == hash_arrays(b=b, a=np.asfortranarray(a)) != hash_arrays(a=b, b=a)
    assert hash_arrays(a=a[:, ::2]) == hash_arrays(a=a[:, ::2].copy())
    with pytest.raises(StoreError, match=naming("'a'", "objects")):
        hash_arrays(a=np.array([{}]))


def test_hash_file_gives_the_digest_of_the_content(tmp_path):
    content = bytes(range(256)) * 5000
    (tmp_path / "mesh.stl").write_bytes(content)
    assert hash_file(tmp_path / "mesh.stl") == hashlib.sha256(content).hexdigest()
    for path, word in ((tmp_path / "none.stl", "none.stl"), (Path("zero\0byte.stl"), "byte.stl")):
        with pytest.raises(StoreError, match=naming(word)):
            hash_file(path)
