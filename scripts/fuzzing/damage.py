"""Damage to files: changed bytes, false lengths, names that lead elsewhere, and unexpected values."""

import codecs
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
FALSE_DTYPES = ["<f8", "<f4", "|u1", "<u2", "|O", "<c16", "<M8[s]", "|V0", "<U0", "|S4000000"]
FALSE_SHAPES = [
    (10**9,), (10**5, 10**5), (2**31, 2**31), (2**62, 8), (0, 10**9), (1,) * 40, (3,), (30_000, 30_000), (),
]  # fmt: skip
BLOCK, BLOCKS = 2**26, 32  # zeros: bytes of a block, and number of blocks


def damage(name: str, content: bytes, other: bytes, draw: Random) -> bytes:
    """Return the damaged content of a file, perhaps with parts of `other`. The suffix of `name` sets the format."""
    suffix = name.rpartition(".")[2].lower()
    if suffix in {"png", "safetensors", *VALUES} and draw.random() < 0.5:
        return _change_form(suffix, content, draw)
    for _ in range(draw.choice([1, 1, 1, 2, 4, 16])):
        content = _change_bytes(content, other, draw)
    return content


def _change_form(suffix: str, content: bytes, draw: Random) -> bytes:
    """Return content in the same valid format, with other values."""
    if suffix == "png":
        return _change_png(content, draw)
    if suffix == "safetensors":
        return _change_safetensors(content, draw)
    if suffix == "npz" and draw.random() < 0.02:
        return _make_inflating(next(iter(_arrays(content))))
    return _change_values(content, *VALUES[suffix], draw)


def _draw_place(content: bytes, draw: Random) -> int:
    """Draw a place in a file, half of the time near the beginning, where lengths are."""
    return draw.randint(0, len(content) if draw.random() < 0.5 else min(len(content), 200))


def _change_bytes(content: bytes, other: bytes, draw: Random) -> bytes:
    """Return the content with one part changed."""
    start = _draw_place(content, draw)
    end = min(len(content), start + draw.choice([1, 2, 4, 16, 100, 1000]))
    part = content[start:end]
    match draw.choice(("number", "number", "extreme", "extreme", "flip", "cut", "remove", "repeat", "text", "splice")):
        case "number" if found := list(WRITTEN.finditer(content[:5000])):  # as in many headers
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
            part, end = other[_draw_place(other, draw) :], len(content)
    return content[:start] + part + content[end:]


# ---- values


def change_tree(tree: Any, draw: Random) -> Any:
    """Return nested values with one value replaced, removed, renamed, doubled or moved to the end."""
    if not isinstance(tree, (dict, list)) or not tree or draw.random() < 0.08:
        return _change_value(tree, draw)
    items = dict(tree if isinstance(tree, dict) else enumerate(tree))
    place, kind = draw.choice(list(items)), draw.random()
    if kind > 0.2:
        items[place] = change_tree(items[place], draw)
    else:
        value = items[place] if kind < 0.05 else items.pop(place)
        if kind < 0.1:
            items[draw.choice([draw.choice(NAMES), f"{place}s"])] = value
    return items if isinstance(tree, dict) else list(items.values())


def _change_value(value: Any, draw: Random) -> Any:
    """Return another value: a number, a bad file name, or a value of another type."""
    if isinstance(value, np.ndarray):
        return _change_array(value, draw)
    others = [draw.choice(draw.choice([NUMBERS, NUMBERS, NAMES, OTHERS]))] * 6 + [[value], str(value)]
    if isinstance(value, str):
        others.append(value + draw.choice(NAMES))
    elif isinstance(value, (int, float)):
        others.append(-value)
    return draw.choice(others)


def _change_values(content: bytes, load: Callable[[bytes], Any], dump: Callable[[Any], bytes], draw: Random) -> bytes:
    """Return the content of a file with one or several changed values."""
    tree = load(content)
    for _ in range(draw.choice([1, 1, 2, 4])):
        tree = change_tree(tree, draw)
    return dump(tree)


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
    from ruamel.yaml import YAML  # a dependency of rosbags

    return YAML(typ="safe").load(content)


# ---- arrays


def _change_array(array: np.ndarray, draw: Random) -> np.ndarray | bytes:
    """Return an array with another shape, another type or extreme numbers, or an .npy file with a false header."""
    kind, flat = draw.random(), array.ravel()
    if kind < 0.15:
        return _make_false_npy(draw)
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


def _make_false_npy(draw: Random) -> bytes:
    """Return an .npy file with a false header."""
    head = _npy_head(draw.choice(FALSE_DTYPES), draw.choice(FALSE_SHAPES), fortran_order=draw.random() < 0.5)
    return head + bytes(draw.choice([0, 8, 1000]))


def _npy_head(dtype: str, shape: tuple[int, ...], fortran_order: bool = False) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": fortran_order, "shape": shape})
    return file.getvalue()


def _from_npy(content: bytes) -> np.ndarray:
    return np.load(io.BytesIO(content), allow_pickle=False)


def _as_npy(value: Any) -> bytes:
    """Return an .npy file of a value, in which numpy pickles Python objects."""
    if isinstance(value, bytes):
        return value
    file = io.BytesIO()
    np.save(file, np.asarray(value), allow_pickle=True)
    return file.getvalue()


def _arrays(content: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return dict(archive)


def _as_npz(tree: Any) -> bytes:
    """Return an archive of arrays, without dates."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, value in (tree if isinstance(tree, dict) else {"value": tree}).items():
            member = zipfile.ZipInfo(f"{name}.npy".encode(errors="replace").decode())
            archive.writestr(member, _as_npy(value), zipfile.ZIP_DEFLATED)
    return file.getvalue()


@cache
def _make_inflating(name: str) -> bytes:
    """Return an archive of a few MB with an array of 2 GiB of zeros."""
    file, member = io.BytesIO(), zipfile.ZipInfo(f"{name}.npy")
    member.compress_type = zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(file, "w") as archive, archive.open(member, "w", force_zip64=True) as array:
        array.write(_npy_head("|u1", (BLOCKS, BLOCK)))
        for _ in range(BLOCKS):
            array.write(bytes(BLOCK))
    return file.getvalue()


# ---- other formats, with correct checksums and lengths


def _change_png(content: bytes, draw: Random) -> bytes:
    """Return a picture whose header has another size, depth or kind."""
    head = bytearray(content[16:29])
    if draw.random() < 0.33:
        head[:8] = struct.pack(">I", draw.choice([9_000, 13_000, 50_000, 2**31 - 1])) * 2
    else:
        head[draw.randrange(13)] = draw.choice([0, 1, 2, 3, 4, 6, 8, 16, 255])
    return content[:16] + head + struct.pack(">I", zlib.crc32(b"IHDR" + head)) + content[33:]


def _change_safetensors(content: bytes, draw: Random) -> bytes:
    size = struct.unpack_from("<Q", content)[0]
    text = _change_values(content[8 : 8 + size], *VALUES["json"], draw)
    return struct.pack("<Q", len(text)) + text + content[8 + size :]


def _read_toml(content: bytes) -> Any:
    return tomllib.loads(content.decode("utf-16" if content[:2] == codecs.BOM_UTF16_LE else "utf-8-sig"))


VALUES: Mapping[str, tuple[Callable[[bytes], Any], Callable[[Any], bytes]]] = {
    "npy": (_from_npy, _as_npy), "npz": (_arrays, _as_npz), "json": (json.loads, _as_json),
    "gltf": (json.loads, _as_json), "toml": (_read_toml, _as_toml), "csv": (_rows, _as_csv),
    "yaml": (_from_yaml, _as_json),
}  # fmt: skip
