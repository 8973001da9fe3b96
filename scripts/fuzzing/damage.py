"""Damage to files: bytes that are changed anywhere, lengths that lie, names that lead elsewhere."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping

import numpy as np

from fuzzing import values

Draw = np.random.Generator
Damage = Callable[[bytes, bytes, Draw], bytes]

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?")
EXTREMES = [struct.pack("<q", n) for n in (0, 1, -1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, -(2**63))]
FLOATS = [struct.pack("<f", x) for x in (np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-42)]
TEXTS = [
    b"-1", b"0", b"4294967296", b"9" * 30, b"1e308", b"1e-320", b"nan", b"inf", b"-inf", b"9" * 5000, b"", b"\x00",
    b"\xff\xfe", b"[" * 3000, b"{" * 3000, b"\n", b"../", b'"', b"'", b",", b"# ", b"\x1b[31m",
]  # fmt: skip
BLOCK, BLOCKS = 2**26, 160  # zeros: 64 MiB at a time, 10 GiB in all
STRUCTURED_SHARE = 0.5  # of the damage to a file whose values can be told apart


def damaged(name: str, content: bytes, other: bytes, draw: Draw) -> bytes:
    """Return the content of a file of that name, damaged; `other` is a file of which parts may be taken."""
    structured = STRUCTURED.get(name.rpartition(".")[2].lower())
    if structured is not None and draw.random() < STRUCTURED_SHARE:
        return structured(content, draw)
    for _ in range(int(draw.choice([1, 1, 1, 2, 4, 16]))):
        content = BYTEWISE[int(draw.integers(len(BYTEWISE)))](content, other, draw)
    return content


def _place(content: bytes, draw: Draw) -> int:
    """A place in a file; its beginning, where the lengths stand, as often as all of the rest."""
    end = len(content) if draw.random() < 0.5 else min(len(content), 200)
    return int(draw.integers(end + 1))


def _span(content: bytes, draw: Draw) -> tuple[int, int]:
    start = _place(content, draw)
    return start, min(len(content), start + int(draw.choice([1, 2, 4, 16, 100, 1000])))


def _flip(content: bytes, other: bytes, draw: Draw) -> bytes:
    if not content:
        return content
    place = min(_place(content, draw), len(content) - 1)
    return content[:place] + bytes([content[place] ^ (1 << int(draw.integers(8)))]) + content[place + 1 :]


def _cut(content: bytes, other: bytes, draw: Draw) -> bytes:
    return content[: _place(content, draw)]


def _remove(content: bytes, other: bytes, draw: Draw) -> bytes:
    start, end = _span(content, draw)
    return content[:start] + content[end:]


def _repeat(content: bytes, other: bytes, draw: Draw) -> bytes:
    start, end = _span(content, draw)
    return content[:end] + content[start:end] * int(draw.choice([1, 2, 50])) + content[end:]


def _swap(content: bytes, other: bytes, draw: Draw) -> bytes:
    a, b = sorted((_place(content, draw), _place(content, draw)))
    size = min(b - a, len(content) - b, 16)
    return content[:a] + content[b : b + size] + content[a + size : b] + content[a : a + size] + content[b + size :]


def _splice(content: bytes, other: bytes, draw: Draw) -> bytes:
    return content[: _place(content, draw)] + other[_place(other, draw) :]


def _extreme(content: bytes, other: bytes, draw: Draw) -> bytes:
    """Overwrite a number: little or big endian, of 1 to 8 bytes."""
    number = (EXTREMES + FLOATS)[int(draw.integers(len(EXTREMES) + len(FLOATS)))][: int(draw.choice([1, 2, 4, 4, 8]))]
    number = number[::-1] if draw.random() < 0.3 else number
    place = _place(content, draw)
    place -= place % len(number) if draw.random() < 0.5 else 0
    return content[:place] + number + content[place + len(number) :]


def _text(content: bytes, other: bytes, draw: Draw) -> bytes:
    place = _place(content, draw)
    return content[:place] + TEXTS[int(draw.integers(len(TEXTS)))] + content[place:]


def _written_number(content: bytes, other: bytes, draw: Draw) -> bytes:
    """Replace a number that is written out, as in the headers of many formats."""
    found = list(NUMBER.finditer(content[:5000]))
    if not found:
        return _extreme(content, other, draw)
    start, end = found[int(draw.integers(len(found)))].span()
    return content[:start] + TEXTS[int(draw.integers(10))] + content[end:]


BYTEWISE: list[Damage] = [
    _flip, _cut, _remove, _repeat, _swap, _splice, _extreme, _extreme, _text, _written_number, _written_number
]  # fmt: skip


# ---- files whose values can be told apart


def _npy(content: bytes, draw: Draw) -> bytes:
    if draw.random() < 0.3:
        return _lying_npy(draw)
    return written_npy(values.strange_array(np.load(io.BytesIO(content), allow_pickle=False), draw))


def written_npy(array: np.ndarray) -> bytes:
    """Return the bytes of an .npy file; Python objects are pickled, as numpy does."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def _lying_npy(draw: Draw) -> bytes:
    """An .npy file whose header promises more than it holds, or something strange."""
    file = io.BytesIO()
    dtypes = ["<f8", "<f4", "|u1", "<u2", "|O", "<c16", "<M8[s]", "|V0", "<U0", "|S4000000"]
    shapes = [(10**9,), (10**5, 10**5), (2**31, 2**31), (2**62, 8), (0, 10**9), (1,) * 40, (3,), (30_000, 30_000), ()]
    header = {
        "descr": dtypes[int(draw.integers(len(dtypes)))], "fortran_order": bool(draw.integers(2)),
        "shape": shapes[int(draw.integers(len(shapes)))],
    }  # fmt: skip
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + bytes(int(draw.choice([0, 8, 1000])))


def _npz(content: bytes, draw: Draw) -> bytes:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    if draw.random() < 0.02:
        return _inflating(next(iter(arrays)))
    members = {f"{name}.npy": written_npy(array) for name, array in values.strange_arrays(arrays, draw).items()}
    if members and draw.random() < 0.15:
        name = list(members)[int(draw.integers(len(members)))]
        members[name] = _lying_npy(draw)
    if draw.random() < 0.15:
        name = values.strange_text(draw).replace("\x00", "") or "x"
        members[name.encode(errors="replace").decode()] = b"outside"
    return _zip(members)


def _zip(members: Mapping[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)  # of no date: the same again
    return file.getvalue()


def _inflating(name: str) -> bytes:
    """An .npz of some ten MB whose one array inflates to 10 GiB of zeros."""
    head = io.BytesIO()
    shape = (BLOCKS * 1024, BLOCK // 1024)
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": shape})
    packer = zlib.compressobj(1, zlib.DEFLATED, -15)
    first = packer.compress(head.getvalue()) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(BLOCK)) + packer.flush(zlib.Z_FULL_FLUSH)  # as good in any other place
    stream = first + block * BLOCKS + packer.flush()
    size = len(head.getvalue()) + BLOCKS * BLOCK
    return _stored_as(f"{name}.npy".encode(), stream, size)


def _stored_as(name: bytes, stream: bytes, size: int) -> bytes:
    """A zip file of one deflated member of 4 GiB and more; its checksum is that of nothing."""
    sizes = struct.pack("<QQ", size, len(stream))
    extra = struct.pack("<HH", 1, len(sizes)) + sizes
    full = 2**32 - 1
    fields = struct.pack("<HHHHHIIIHH", 45, 0, 8, 0, 33, 0, full, full, len(name), len(extra))
    local = b"PK\x03\x04" + fields + name + extra + stream
    central = b"PK\x01\x02\x2d\x00" + fields + struct.pack("<HHHII", 0, 0, 0, 0, 0) + name + extra
    return local + central + b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local), 0)


def _png(content: bytes, draw: Draw) -> bytes:
    """Another size, depth or kind in the header, whose checksum is right."""
    kind = int(draw.integers(3))
    if kind == 0:
        return _huge_png(int(draw.choice([9_000, 13_000, 50_000, 2**31 - 1])))
    head = bytearray(content[16:29])
    place = int(draw.integers(13))
    head[place] = int(draw.choice([0, 1, 2, 3, 4, 6, 8, 16, 255]))
    return content[:16] + bytes(head) + struct.pack(">I", zlib.crc32(b"IHDR" + bytes(head))) + content[33:]


def _huge_png(side: int) -> bytes:
    """A picture of so many pixels a side, almost without data."""
    head = struct.pack(">IIBBBBB", side, side, 16, 0, 0, 0, 0)
    parts = [(b"IHDR", head), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")]
    chunks = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in parts]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def _glb(content: bytes, draw: Draw) -> bytes:
    """Another value in the JSON of a binary glTF, its lengths right."""
    size = struct.unpack_from("<I", content, 12)[0]
    text = values.strange_json(content[20 : 20 + size], draw)
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    return content[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + content[16:20] + text + rest


def _safetensors(content: bytes, draw: Draw) -> bytes:
    """Another value in the head of a safetensors file, its length right."""
    size = struct.unpack_from("<Q", content)[0]
    text = values.strange_json(content[8 : 8 + size], draw)
    return struct.pack("<Q", len(text)) + text + content[8 + size :]


STRUCTURED: dict[str, Callable[[bytes, Draw], bytes]] = {
    "npy": _npy, "npz": _npz, "png": _png, "glb": _glb, "safetensors": _safetensors, "json": values.strange_json,
    "gltf": values.strange_json, "toml": values.strange_toml, "csv": values.strange_csv, "yaml": values.strange_lines,
}  # fmt: skip
