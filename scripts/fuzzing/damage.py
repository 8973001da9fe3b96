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
from random import Random
from typing import Any

import numpy as np

WRITTEN = re.compile(rb"[-+]?\d+(?:\.\d+)?")
INTEGERS = [struct.pack("<q", n) for n in (0, 1, -1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, -(2**63))]
FLOATS = [struct.pack("<f", x) for x in (np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-42)]
NUMBER_TEXTS = [b"-1", b"0", b"4294967296", b"9" * 30, b"1e308", b"1e-320", b"nan", b"inf", b"-inf", b"9" * 5000]
TEXTS = [
    *NUMBER_TEXTS, b"", b"\x00", b"\xff\xfe", b"[" * 3000, b"{" * 3000, b"\n", b"../", b'"', b"'", b",", b"# ",
    b"\x1b[31m",
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
KINDS = ("flip", "cut", "remove", "repeat", "swap", "splice", "extreme", "extreme", "text", "number", "number")
BLOCK, BLOCKS = 2**26, 160  # zeros: 64 MiB at a time, 10 GiB in all


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
    kind, start = draw.choice(KINDS), _place(content, draw)
    end = min(len(content), start + draw.choice([1, 2, 4, 16, 100, 1000]))
    part = content[start:end]
    if kind == "number" and (found := list(WRITTEN.finditer(content[:5000]))):  # as in the headers of many formats
        (start, end), part = draw.choice(found).span(), draw.choice(NUMBER_TEXTS)
    elif kind in ("extreme", "number"):  # 1 to 8 bytes, little or big endian
        part = draw.choice(INTEGERS + FLOATS)[: draw.choice([1, 2, 4, 4, 8])][:: draw.choice([1, 1, -1])]
        start -= start % len(part) if draw.random() < 0.5 else 0
        end = start + len(part)
    elif kind == "flip":
        part = bytes(byte ^ (1 << draw.randrange(8) if k == 0 else 0) for k, byte in enumerate(part))
    elif kind == "cut":
        return content[:start]
    elif kind == "remove":
        part = b""
    elif kind == "repeat":
        part *= draw.choice([2, 3, 51])
    elif kind == "text":
        part = draw.choice(TEXTS) + part
    elif kind == "splice":
        return content[:start] + other[_place(other, draw) :]
    else:
        a, b = sorted((start, _place(content, draw)))
        size = min(b - a, len(content) - b, 16)
        return content[:a] + content[b : b + size] + content[a + size : b] + content[a : a + size] + content[b + size :]
    return content[:start] + part + content[end:]


# ---- values


def strange_value(draw: Random) -> Any:
    """Return a number, a bad name of a file or something else."""
    return draw.choice(draw.choice([NUMBERS, NUMBERS, NAMES, OTHERS]))


def strange_tree(tree: Any, draw: Random) -> Any:
    """Return nested values of which one, anywhere, is another, is missing, is renamed, or stands twice."""
    if not isinstance(tree, (dict, list)) or not tree or draw.random() < 0.08:
        others = [strange_value(draw)] * 6 + [[tree], str(tree)]
        others += [-tree] if isinstance(tree, (int, float)) else []
        return draw.choice(others + ([tree + draw.choice(NAMES)] if isinstance(tree, str) else []))
    place = draw.choice(list(tree)) if isinstance(tree, dict) else draw.randrange(len(tree))
    kind = draw.random()
    if kind > 0.2:
        changed = strange_tree(tree[place], draw)
        return {**tree, place: changed} if isinstance(tree, dict) else [*tree[:place], changed, *tree[place + 1 :]]
    if isinstance(tree, list):
        return tree[:place] + tree[place + 1 :] if kind < 0.1 else [*tree, tree[place]]
    rest = {key: value for key, value in tree.items() if key != place}
    return rest if kind < 0.1 else {**rest, draw.choice([draw.choice(NAMES), f"{place}s"]): tree[place]}


def _strange_trees(tree: Any, draw: Random) -> Any:
    for _ in range(draw.choice([1, 1, 2, 4])):
        tree = strange_tree(tree, draw)
    return tree


def _json(content: bytes, draw: Random) -> bytes:
    return json.dumps(_strange_trees(json.loads(content), draw)).encode()


def _toml(content: bytes, draw: Random) -> bytes:
    tree = _strange_trees(tomllib.loads(content.decode()), draw)
    tree = tree if isinstance(tree, dict) else {"value": tree}
    return "".join(f"{json.dumps(key)} = {_inline(one)}\n" for key, one in tree.items() if one is not None).encode()


def _inline(value: Any) -> str:
    """Return a value as inline TOML, without None."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_inline(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(item) for item in value if item is not None) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)  # nan and inf as TOML has them


def _csv(content: bytes, draw: Random) -> bytes:
    """Return a table with changed cells, and rows or columns that are missing or doubled."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    for _ in range(draw.choice([1, 1, 2, 4])):
        row, kind = draw.choice(rows), draw.randrange(4)
        if kind == 0 and len(rows) > 1:
            rows.remove(row)
        elif kind == 1:
            row.extend(row)
        elif row:
            row[draw.randrange(len(row))] = str(strange_value(draw))
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue().encode(errors="surrogatepass")


def _lines(content: bytes, draw: Random) -> bytes:
    """Return a text of which a line is missing, doubled, or has another end."""
    lines = content.decode().splitlines(keepends=True)
    k = draw.randrange(len(lines))
    changed = f"{lines[k].partition(':')[0]}: {strange_value(draw)}\n"
    lines[k] = draw.choice(["", lines[k] * 2, changed, "&a [*a]\n", "!!python/object:os.x {}\n"])
    return "".join(lines).encode(errors="surrogatepass")


# ---- arrays


def _strange_arrays(arrays: dict[str, np.ndarray], draw: Random) -> None:
    """Remove, rename, exchange or change arrays."""
    for _ in range(draw.choice([1, 1, 2])):
        if not arrays:
            return
        name, other, kind = draw.choice(list(arrays)), draw.choice(list(arrays)), draw.random()
        if kind < 0.1:
            del arrays[name]
        elif kind < 0.15:
            arrays[f"{name}s"] = arrays.pop(name)
        elif kind < 0.25:
            arrays[name], arrays[other] = arrays[other], arrays[name]
        else:
            arrays[name] = _strange_array(arrays[name], draw)


def _strange_array(array: np.ndarray, draw: Random) -> np.ndarray:
    """Return an array of another shape or type, or with strange numbers in it."""
    kind, flat = draw.random(), array.ravel()
    if kind < 0.35:
        shapes = [array.T, flat, array[None], array[..., None], flat[:0], flat[:1].reshape(()) if flat.size else array]
        more = [array[:1], array[..., :-1], np.concatenate([array, array]), array[:0]] if array.ndim else []
        return draw.choice(shapes + more)
    with np.errstate(all="ignore"):
        if kind < 0.6:
            try:
                return array.astype(dtype := draw.choice(DTYPES))
            except (TypeError, ValueError):
                return np.zeros(array.shape, dtype)
        if array.dtype.kind not in "fiu" or array.size == 0:
            return np.full(array.shape, draw.choice(NAMES).replace("\x00", ""))
        found, number = flat.copy(), float(draw.choice(NUMBERS))
        places = draw.sample(range(found.size), 1 + int(draw.choice([0.0, 0.01, 1.0]) * (found.size - 1)))
        if np.isfinite(number) or array.dtype.kind == "f":
            found[places] = np.asarray(number).astype(found.dtype)
        else:
            found[places] = np.iinfo(array.dtype).max
    return found.reshape(array.shape)


def _npy(content: bytes, draw: Random) -> bytes:
    if draw.random() < 0.3:
        return _lying_npy(draw)
    return _saved(_strange_array(np.load(io.BytesIO(content), allow_pickle=False), draw))


def _saved(array: np.ndarray) -> bytes:
    """Return the bytes of an .npy file; Python objects are pickled, as numpy does."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def _lying_npy(draw: Random) -> bytes:
    """Return an .npy file whose header promises more than it holds, or something strange."""
    head = _npy_head(draw.choice(LYING_DTYPES), draw.choice(LYING_SHAPES), fortran_order=draw.random() < 0.5)
    return head + bytes(draw.choice([0, 8, 1000]))


def _npy_head(dtype: str, shape: tuple[int, ...], fortran_order: bool = False) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": fortran_order, "shape": shape})
    return file.getvalue()


def _npz(content: bytes, draw: Random) -> bytes:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    if draw.random() < 0.02:
        return _inflating(f"{next(iter(arrays))}.npy".encode())
    _strange_arrays(arrays, draw)
    members = {f"{name}.npy": _saved(array) for name, array in arrays.items()}
    if members and draw.random() < 0.15:
        members[draw.choice(list(members))] = _lying_npy(draw)
    if draw.random() < 0.15:
        members[(draw.choice(NAMES).replace("\x00", "") or "x").encode(errors="replace").decode()] = b"outside"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(zipfile.ZipInfo(name), member, zipfile.ZIP_DEFLATED)  # of no date: the same again
    return file.getvalue()


def _inflating(name: bytes) -> bytes:
    """Return a zip file of some ten MB whose one member, without a checksum, inflates to 10 GiB of zeros."""
    head, packer = _npy_head("|u1", (BLOCKS * 1024, BLOCK // 1024)), zlib.compressobj(1, zlib.DEFLATED, -15)
    first = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(BLOCK)) + packer.flush(zlib.Z_FULL_FLUSH)  # the same in any other place
    stream = first + block * BLOCKS + packer.flush()
    extra = struct.pack("<HHQQ", 1, 16, len(head) + BLOCKS * BLOCK, len(stream))
    sizes = (2**32 - 1, 2**32 - 1, len(name), len(extra))
    fields = struct.pack("<HHHHHIIIHH", 45, 0, 8, 0, 33, 0, *sizes)
    local = b"PK\x03\x04" + fields + name + extra + stream
    central = b"PK\x01\x02\x2d\x00" + fields + struct.pack("<HHHII", 0, 0, 0, 0, 0) + name + extra
    return local + central + b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local), 0)


# ---- other formats whose checksums and lengths stay right


def _png(content: bytes, draw: Random) -> bytes:
    """Return a picture with another size, depth or kind in its header."""
    if draw.random() < 0.33:
        side = draw.choice([9_000, 13_000, 50_000, 2**31 - 1])
        head = _chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 16, 0, 0, 0, 0))
        return content[:8] + head + _chunk(b"IDAT", zlib.compress(bytes(1000))) + _chunk(b"IEND", b"")
    head = bytearray(content[16:29])
    head[draw.randrange(13)] = draw.choice([0, 1, 2, 3, 4, 6, 8, 16, 255])
    return content[:8] + _chunk(b"IHDR", bytes(head)) + content[33:]


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _glb(content: bytes, draw: Random) -> bytes:
    size = struct.unpack_from("<I", content, 12)[0]
    text, rest = _json(content[20 : 20 + size], draw), content[20 + size :]
    text += b" " * (-len(text) % 4)
    return content[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + content[16:20] + text + rest


def _safetensors(content: bytes, draw: Random) -> bytes:
    size = struct.unpack_from("<Q", content)[0]
    text = _json(content[8 : 8 + size], draw)
    return struct.pack("<Q", len(text)) + text + content[8 + size :]


STRUCTURED: Mapping[str, Callable[[bytes, Random], bytes]] = {
    "npy": _npy, "npz": _npz, "png": _png, "glb": _glb, "safetensors": _safetensors, "json": _json, "gltf": _json,
    "toml": _toml, "csv": _csv, "yaml": _lines,
}  # fmt: skip
