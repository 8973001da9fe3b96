"""Damage to files: bytes changed anywhere, lengths that lie, names that lead elsewhere, and unexpected values."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from random import Random
from typing import Any

import numpy as np

from tactile_loc.io.toml import format_toml

WRITTEN = re.compile(rb"[-+]?\d+(?:\.\d+)?")
INTEGERS = [struct.pack("<q", n) for n in (0, 1, -1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, -(2**63))]
FLOATS = [struct.pack("<f", x) for x in (np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-42)]
NUMBER_TEXTS = [b"-1", b"0", b"4294967296", b"9" * 30, b"1e308", b"1e-320", b"nan", b"inf", b"-inf", b"9" * 5000]
TEXTS = [
    *NUMBER_TEXTS, b"", b"\x00", b"\xff\xfe", b"[" * 3000, b"{" * 3000, b"\n", b"../", b'"', b"'", b",", b"# ",
    b"\x1b[31m", b"&a [*a]\n", b"!!python/object:os.x {}\n",
]  # fmt: skip
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
DTYPES = [
    "f2", "f4", "f8", ">f8", "i1", "i8", "u1", "u2", ">u2", "u8", "?", "c16", "U8", "S8", "M8[s]", "m8[s]", "O", "V4",
]  # fmt: skip
LYING_DTYPES = ["<f8", "<f4", "|u1", "<u2", "|O", "<c16", "<M8[s]", "|V0", "<U0", "|S4000000"]
LYING_SHAPES = [
    (10**9,), (10**5, 10**5), (2**31, 2**31), (2**62, 8), (0, 10**9), (1,) * 40, (3,), (30_000, 30_000), (),
]  # fmt: skip
BLOCK, BLOCKS = 2**26, 32  # zeros: 64 MiB at a time, 2 GiB in all

Change = Callable[[bytes, Random], bytes]


def damaged(name: str, content: bytes, other: bytes, draw: Random) -> bytes:
    """Return the damaged content of a file of that name; parts of `other` may be taken."""
    structured = STRUCTURED.get(name.rpartition(".")[2].lower())
    if structured is not None and draw.random() < 0.5:
        return structured(content, draw)
    for _ in range(draw.choice([1, 1, 1, 2, 4, 16])):
        content = _bytes_changed(content, other, draw)
    return content


def _place(content: bytes, draw: Random) -> int:
    """Draw a place in a file; the beginning, where lengths stand, as often as all of the rest."""
    return draw.randint(0, len(content) if draw.random() < 0.5 else min(len(content), 200))


def _bytes_changed(content: bytes, other: bytes, draw: Random) -> bytes:
    """Return a file with something else in place of one part."""
    start = _place(content, draw)
    end = min(len(content), start + draw.choice([1, 2, 4, 16, 100, 1000]))
    part = content[start:end]
    match draw.choice(("number", "number", "extreme", "extreme", "flip", "cut", "remove", "repeat", "text", "splice")):
        case "number" if found := list(WRITTEN.finditer(content[:5000])):  # as in the headers of many formats
            (start, end), part = draw.choice(found).span(), draw.choice(NUMBER_TEXTS)
        case "number" | "extreme":  # 1 to 8 bytes, little or big endian
            part = draw.choice(INTEGERS + FLOATS)[: draw.choice([1, 2, 4, 4, 8])][:: draw.choice([1, 1, -1])]
            start -= start % len(part) if draw.random() < 0.5 else 0
            end = start + len(part)
        case "flip":
            part = bytes(byte ^ (1 << draw.randrange(8) if k == 0 else 0) for k, byte in enumerate(part))
        case "cut":
            part, end = b"", len(content)
        case "remove":
            part = b""
        case "repeat":
            part *= draw.choice([2, 3, 51])
        case "text":
            part = draw.choice(TEXTS) + part
        case "splice":
            part, end = other[_place(other, draw) :], len(content)
    return content[:start] + part + content[end:]


# ---- values


def strange_tree(tree: Any, draw: Random) -> Any:
    """Return nested values of which one, anywhere, is another, is missing, is renamed, or stands twice or last."""
    if not isinstance(tree, (dict, list)) or not tree or draw.random() < 0.08:
        return _strange_value(tree, draw)
    items = dict(tree if isinstance(tree, dict) else enumerate(tree))
    place, kind = draw.choice(list(items)), draw.random()
    if kind > 0.2:
        items[place] = strange_tree(items[place], draw)
    else:
        value = items[place] if kind < 0.05 else items.pop(place)
        if kind < 0.1:
            items[draw.choice([draw.choice(NAMES), f"{place}s"])] = value
    return items if isinstance(tree, dict) else list(items.values())


def _strange_value(value: Any, draw: Random) -> Any:
    """Return another value: a number, a bad name of a file or something else."""
    if isinstance(value, np.ndarray):
        return _strange_array(value, draw)
    others = [draw.choice(draw.choice([NUMBERS, NUMBERS, NAMES, OTHERS]))] * 6 + [[value], str(value)]
    if isinstance(value, str):
        others.append(value + draw.choice(NAMES))
    elif isinstance(value, (int, float)):
        others.append(-value)
    return draw.choice(others)


def _changed(load: Callable[[bytes], Any], dump: Callable[[Any], bytes]) -> Change:
    """Return what changes the values of a format, once or several times."""

    def change(content: bytes, draw: Random) -> bytes:
        tree = load(content)
        for _ in range(draw.choice([1, 1, 2, 4])):
            tree = strange_tree(tree, draw)
        return dump(tree)

    return change


def _as_json(tree: Any) -> bytes:
    return json.dumps(tree).encode()


def _as_toml(tree: Any) -> bytes:
    text = format_toml(tree if isinstance(tree, dict) else {"value": tree})
    return text.replace("NaN", "nan").replace("Infinity", "inf").encode(errors="surrogatepass")


def _as_csv(tree: Any) -> bytes:
    text = io.StringIO()
    rows = tree if isinstance(tree, list) else [tree]
    csv.writer(text).writerows(row if isinstance(row, list) else [row] for row in rows)
    return text.getvalue().encode(errors="surrogatepass")


def _rows(content: bytes) -> list[list[str]]:
    return list(csv.reader(io.StringIO(content.decode())))


def _from_yaml(content: bytes) -> Any:
    from ruamel.yaml import YAML  # which rosbags needs

    return YAML(typ="safe").load(content)


# ---- arrays


def _strange_array(array: np.ndarray, draw: Random) -> np.ndarray | bytes:
    """Return an array of another shape or type, or with strange numbers in it, or a file that lies."""
    kind, flat = draw.random(), array.ravel()
    if kind < 0.15:
        return _lying_npy(draw)
    if kind < 0.35:
        ends = [array[:1], array[..., :-1], np.concatenate([array, array])] if array.ndim else []
        return draw.choice([array.T, flat, array[None], array[..., None], flat[:0], *ends])
    with np.errstate(all="ignore"), suppress(TypeError, ValueError):
        if kind < 0.6:
            return array.astype(draw.choice(DTYPES))
        if kind < 0.9:
            found = array.astype("f8") if draw.random() < 0.2 else array.copy()
            some = np.random.default_rng(draw.getrandbits(32)).random(array.shape) < draw.choice([0.001, 0.1, 1.0])
            found[some] = np.float64(draw.choice(NUMBERS)).astype(found.dtype)
            return found
    return np.full(array.shape, draw.choice(NAMES).replace("\x00", ""))


def _lying_npy(draw: Random) -> bytes:
    """Return an .npy file whose header promises more than it holds, or something strange."""
    head = _npy_head(draw.choice(LYING_DTYPES), draw.choice(LYING_SHAPES), fortran_order=draw.random() < 0.5)
    return head + bytes(draw.choice([0, 8, 1000]))


def _npy_head(dtype: str, shape: tuple[int, ...], fortran_order: bool = False) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": fortran_order, "shape": shape})
    return file.getvalue()


def _from_npy(content: bytes) -> np.ndarray:
    return np.load(io.BytesIO(content), allow_pickle=False)


def _as_npy(value: Any) -> bytes:
    """Return the bytes of an .npy file; Python objects are pickled, as numpy does."""
    if isinstance(value, bytes):
        return value
    file = io.BytesIO()
    np.save(file, np.asarray(value), allow_pickle=True)
    return file.getvalue()


def _arrays(content: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return dict(archive)


def _as_npz(tree: Any) -> bytes:
    """Return an archive of arrays, of no date: the same again."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, value in (tree if isinstance(tree, dict) else {"value": tree}).items():
            member = zipfile.ZipInfo(f"{name}.npy".encode(errors="replace").decode())
            archive.writestr(member, _as_npy(value), zipfile.ZIP_DEFLATED)
    return file.getvalue()


def _npz(content: bytes, draw: Random) -> bytes:
    if draw.random() < 0.02:
        return _inflating(next(iter(_arrays(content))))
    return _changed(_arrays, _as_npz)(content, draw)


@cache
def _inflating(name: str) -> bytes:
    """Return an archive of some MB whose one array is of zeros and far larger."""
    file, member = io.BytesIO(), zipfile.ZipInfo(f"{name}.npy")
    member.compress_type = zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(file, "w") as archive, archive.open(member, "w", force_zip64=True) as array:
        array.write(_npy_head("|u1", (BLOCKS, BLOCK)))
        for _ in range(BLOCKS):
            array.write(bytes(BLOCK))
    return file.getvalue()


# ---- other formats whose checksums and lengths stay right


def _png(content: bytes, draw: Random) -> bytes:
    """Return a picture with another size, depth or kind in its header."""
    head = bytearray(content[16:29])
    if draw.random() < 0.33:
        head[:8] = struct.pack(">I", draw.choice([9_000, 13_000, 50_000, 2**31 - 1])) * 2
    else:
        head[draw.randrange(13)] = draw.choice([0, 1, 2, 3, 4, 6, 8, 16, 255])
    return content[:16] + head + struct.pack(">I", zlib.crc32(b"IHDR" + head)) + content[33:]


def _safetensors(content: bytes, draw: Random) -> bytes:
    size = struct.unpack_from("<Q", content)[0]
    text = _json(content[8 : 8 + size], draw)
    return struct.pack("<Q", len(text)) + text + content[8 + size :]


_json = _changed(json.loads, _as_json)
STRUCTURED: Mapping[str, Change] = {
    "npy": _changed(_from_npy, _as_npy), "npz": _npz, "png": _png, "safetensors": _safetensors,
    "json": _json, "gltf": _json, "toml": _changed(lambda content: tomllib.loads(content.decode()), _as_toml),
    "csv": _changed(_rows, _as_csv), "yaml": _changed(_from_yaml, _as_json),
}  # fmt: skip
