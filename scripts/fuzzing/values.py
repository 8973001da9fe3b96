"""Values that nobody expected, in TOML, JSON, CSV and arrays whose form is right."""

from __future__ import annotations

import csv
import io
import json
import math
import tomllib
from collections.abc import Mapping
from typing import Any

import numpy as np

Draw = np.random.Generator

NAMES = [
    "", ".", "..", "../escaped", "../../escaped.npz", "/etc/passwd", "/dev/zero", "/nowhere/file.npz", "~/file",
    "a\x00b", "two\nlines", "\x1b[31mred\x1b[0m", "\u202egnp.x", "\ud7ff\u0301", "\ud800", "x" * 5000, "con",
    "file:///etc/passwd", "*", "%s{0}",
]  # fmt: skip
NUMBERS = [
    0, 1, -1, 2, 255, 65536, 2**31, 2**53, 2**63, -(2**63), 10**30, 0.0, -0.0, 0.5, 1e-300, 1e-9, 1e9, 1e300,
    math.nan, math.inf, -math.inf,
]  # fmt: skip
OTHERS = [None, True, False, [], {}, [[]], [None], [0] * 1000, [[0.0] * 4] * 4, {"path": "x"}, {"": {}}]
DTYPES = ["f2", "f4", "f8", ">f8", "i1", "i8", "u1", "u2", ">u2", "u8", "?", "c16", "U8", "S8",
          "M8[s]", "m8[s]", "O", "V4"]  # fmt: skip


def strange_text(draw: Draw) -> str:
    """Return a text that is no good name of a file."""
    return NAMES[int(draw.integers(len(NAMES)))]


def strange_value(draw: Draw) -> Any:
    """Return a number, a text or something else."""
    kind = draw.random()
    if kind < 0.5:
        return NUMBERS[int(draw.integers(len(NUMBERS)))]
    return strange_text(draw) if kind < 0.75 else OTHERS[int(draw.integers(len(OTHERS)))]


def strange_tree(tree: Any, draw: Draw) -> Any:
    """Return nested values of which one, anywhere, is another, is missing, or stands twice."""
    if not isinstance(tree, (dict, list)) or not tree or draw.random() < 0.08:
        return _other(tree, draw)
    places = list(tree) if isinstance(tree, dict) else list(range(len(tree)))
    place = places[int(draw.integers(len(places)))]
    kind = draw.random()
    if kind > 0.2:
        changed = strange_tree(tree[place], draw)
        return {**tree, place: changed} if isinstance(tree, dict) else [*tree[:place], changed, *tree[place + 1 :]]
    if isinstance(tree, list):
        return tree[:place] + tree[place + 1 :] if kind < 0.1 else [*tree, tree[place]]
    rest = {key: value for key, value in tree.items() if key != place}
    renamed = strange_text(draw) if kind > 0.15 else f"{place}s"
    return rest if kind < 0.1 else {**rest, renamed: tree[place]}


def _other(value: Any, draw: Draw) -> Any:
    """Another value, or the same in another form."""
    kind = draw.random()
    if kind < 0.1:
        return [value]
    if kind < 0.2:
        return str(value)
    if kind < 0.3 and isinstance(value, (int, float)):
        return type(value)(-value)
    if kind < 0.4 and isinstance(value, str):
        return value + strange_text(draw)
    return strange_value(draw)


def strange_json(content: bytes, draw: Draw) -> bytes:
    """Return a JSON document with values changed; numbers may be NaN, as Python writes them."""
    tree = json.loads(content)
    for _ in range(int(draw.choice([1, 1, 2, 4]))):
        tree = strange_tree(tree, draw)
    return json.dumps(tree).encode()


def strange_toml(content: bytes, draw: Draw) -> bytes:
    """Return a TOML document with values changed."""
    tree = tomllib.loads(content.decode())
    for _ in range(int(draw.choice([1, 1, 2, 4]))):
        tree = strange_tree(tree, draw)
    return written_toml(tree if isinstance(tree, Mapping) else {"value": tree}).encode()


def written_toml(tree: Mapping[str, Any]) -> str:
    """Return values as TOML, tables inline; None is left out."""
    return "".join(f"{json.dumps(key)} = {_toml(value)}\n" for key, value in tree.items() if value is not None)


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value if item is not None) + "]"
    if isinstance(value, float):
        return repr(value)  # nan and inf as TOML has them
    return json.dumps(value)


def strange_csv(content: bytes, draw: Draw) -> bytes:
    """Return a table with cells changed, rows or columns missing or doubled."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    for _ in range(int(draw.choice([1, 1, 2, 4]))):
        row = rows[int(draw.integers(len(rows)))]
        kind = int(draw.integers(4))
        if kind == 0 and len(rows) > 1:
            rows.remove(row)
        elif kind == 1:
            row.extend(row)
        elif row:
            row[int(draw.integers(len(row)))] = str(strange_value(draw))
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue().encode(errors="surrogatepass")


def strange_lines(content: bytes, draw: Draw) -> bytes:
    """Return a text of which a line is missing, doubled, or has another end."""
    lines = content.decode().splitlines(keepends=True)
    place = int(draw.integers(len(lines)))
    line = lines[place]
    changed = f"{line.partition(':')[0]}: {strange_value(draw)}\n"
    other = ["", line + line, changed, "&a [*a]\n", "!!python/object:os.x {}\n"]
    lines[place] = other[int(draw.integers(len(other)))]
    return "".join(lines).encode(errors="surrogatepass")


def strange_arrays(arrays: Mapping[str, np.ndarray], draw: Draw) -> dict[str, np.ndarray]:
    """Return arrays of which one is missing, called otherwise, exchanged for another, or of other numbers."""
    changed = dict(arrays)
    for _ in range(int(draw.choice([1, 1, 2]))):
        if not changed:
            return changed
        names = list(changed)
        name, other = (names[int(i)] for i in draw.integers(len(names), size=2))
        kind = draw.random()
        if kind < 0.1:
            del changed[name]
        elif kind < 0.15:
            changed[f"{name}s"] = changed.pop(name)
        elif kind < 0.25:
            changed[name], changed[other] = changed[other], changed[name]
        else:
            changed[name] = strange_array(changed[name], draw)
    return changed


def strange_array(array: np.ndarray, draw: Draw) -> np.ndarray:
    """Return an array of another shape or type, or with strange numbers in it."""
    kind = draw.random()
    if kind < 0.35:
        return _reshaped(array, draw)
    if kind < 0.6:
        return _cast(array, DTYPES[int(draw.integers(len(DTYPES)))])
    return _with_strange_numbers(array, draw)


def _reshaped(array: np.ndarray, draw: Draw) -> np.ndarray:
    shapes = [array.T, array.ravel(), array[None], array[..., None], array.ravel()[:0], array.ravel()[:1].reshape(())
              if array.size else array, array[:1] if array.ndim else array, array[..., :-1] if array.ndim else array,
              np.concatenate([array, array]) if array.ndim else array, array[:0] if array.ndim else array]  # fmt: skip
    return shapes[int(draw.integers(len(shapes)))]


def _cast(array: np.ndarray, dtype: str) -> np.ndarray:
    with np.errstate(all="ignore"):
        try:
            return array.astype(dtype)
        except (TypeError, ValueError):
            return np.zeros(array.shape, dtype)


def _with_strange_numbers(array: np.ndarray, draw: Draw) -> np.ndarray:
    if array.dtype.kind not in "fiu" or array.size == 0:
        return np.full(array.shape, strange_text(draw).replace("\x00", ""))
    found = array.copy()
    share = float(draw.choice([0.0, 0.01, 1.0]))
    chosen = draw.random(found.shape) < share
    chosen.flat[int(draw.integers(found.size))] = True
    number = float(NUMBERS[int(draw.integers(len(NUMBERS)))])
    with np.errstate(all="ignore"):
        found[chosen] = np.asarray(number).astype(found.dtype) if np.isfinite(number) else _infinite(found, number)
    return found


def _infinite(array: np.ndarray, number: float) -> Any:
    return number if array.dtype.kind == "f" else np.iinfo(array.dtype).max
