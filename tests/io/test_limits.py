"""The memory that readers take for small files that unpack to, or claim, far more than the limits."""

import io
import json
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from PIL import Image

MB = 2**20
HUGE = 768 * MB  # what the files unpack to
MOST_MB = 192  # three times the largest peak, of the libraries that a record needs

CHILD = """
import json, os, resource, sys, zipfile
from pathlib import Path
from types import SimpleNamespace
import mcap.stream_reader, safetensors.numpy, scipy.spatial, trimesh
from PIL import Image
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.images import read_photo
from tactile_loc.io.meshes.mesh_files import read_surface
from tactile_loc.io.streams.recordings import Recording
from tactile_loc.io.touches import read_touch
from tactile_loc.store.arrays import read_member

def read(path):
    kind = path.suffix
    if kind == ".zip":
        with zipfile.ZipFile(path) as archive:
            return [read_member(archive, one) for one in archive.infolist()]
    if kind in (".tif", ".jpg") or path.stem == "photo":
        return read_photo(path)
    if kind in (".npz", ".npy", ".png"):
        geometry = SensorGeometry("orthographic", 48, 40, 1e4, 1e4, 24, 20, 0.01, 2e-3)
        sensor = SimpleNamespace(geometry=geometry)
        return read_touch(path, sensor, "mm", kind="mask" if path.stem == "mask" else None)
    readers = {
        ".mcap": lambda path: Recording(path).read_contents(),
        ".safetensors": safetensors.numpy.load_file,
    }
    return readers.get(kind, read_surface)(path)

def measure(path):
    child = os.fork()
    if child == 0:
        try:
            path is None or read(path)
            os._exit(1)
        except (TactileLocError, ValueError, safetensors.SafetensorError):
            os._exit(0)
        except BaseException:
            os._exit(2)
    _, status, used = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), used.ru_maxrss / 1024

base = measure(None)[1]
found = {path.name: measure(path) for path in sorted(Path(sys.argv[1]).iterdir())}
print(json.dumps({name: (code, mb - base) for name, (code, mb) in found.items()}))
"""


def deflate(size: int, wbits: int, head: bytes = b"") -> bytes:
    """Return a stream that unpacks to `head`, and then to zeros."""
    block = bytes(4 * MB)
    packer = zlib.compressobj(1, wbits=wbits)
    start = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    one = packer.compress(block) + packer.flush(zlib.Z_FULL_FLUSH)
    return start + one * (size // len(block)) + packer.flush()


def zip_member(name: str, packed: bytes, size: int) -> bytes:
    """Return a zip archive with one deflated member that states its size."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(name, packed)
    content = bytearray(file.getvalue())
    for at, method, stated in ((0, 8, 22), (content.rindex(b"PK\x01\x02"), 10, 24)):
        struct.pack_into("<H", content, at + method, zipfile.ZIP_DEFLATED)
        struct.pack_into("<L", content, at + stated, size)
    return bytes(content)


def npy_head(shape: tuple[int, ...]) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return file.getvalue()


def npz(shape: tuple[int, ...], name: str = "depth") -> bytes:
    head = npy_head(shape)
    return zip_member(f"{name}.npy", deflate(HUGE, -15, head), len(head) + HUGE)


def png(depth: int, colours: int) -> bytes:
    """Return a picture of zeros, 20 to 28 thousand pixels along a side."""
    side = int((HUGE * 8 / depth) ** 0.5)
    head = struct.pack(">LLBBBBB", side, side, depth, colours, 0, 0, 0)
    parts = [b"IHDR" + head, b"IDAT" + deflate(HUGE, 15), b"IEND"]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">L", len(part) - 4) + part + struct.pack(">L", zlib.crc32(part)) for part in parts
    )


def picture(kind: str, old: bytes, new: bytes) -> bytes:
    """Return a picture whose header states another size."""
    file = io.BytesIO()
    Image.new("RGB", (77, 77)).save(file, kind)
    content = file.getvalue()
    assert old in content
    return content.replace(old, new)


def zstd(size: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    block = bytes(4 * MB)
    return b"".join(packer.compress(block) for _ in range(size // len(block))) + packer.flush()


def mcap(stated: int) -> bytes:
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start()
    writer.finish()
    chunk = zstd(HUGE)
    body = struct.pack("<QQQLL4sQ", 0, 0, stated, 0, 4, b"zstd", len(chunk)) + chunk
    end = file.getvalue().index(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")  # the record DataEnd
    return file.getvalue()[:end] + b"\x06" + struct.pack("<Q", len(body)) + body + file.getvalue()[end:]


def gltf() -> bytes:
    accessors = [{"componentType": 5126, "count": HUGE // 12, "type": "VEC3"}]
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}}]}]
    tree = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
    return json.dumps({**tree, "accessors": accessors, "meshes": meshes}).encode()


def ply(form: str) -> bytes:
    vertex, face = "".join(f"property float {axis}\n" for axis in "xyz"), "property list uchar int vertex_indices\n"
    head = f"ply\nformat {form} 1.0\nelement vertex 3000000000\n{vertex}element face 2000000000\n{face}end_header\n"
    return head.encode() + b"0 0 0\n" * 3


def safetensors() -> bytes:
    header = json.dumps({"a": {"dtype": "F32", "shape": [HUGE], "data_offsets": [0, 4 * HUGE]}}).encode()
    return struct.pack("<Q", len(header)) + header + bytes(64)


SIDE = int((HUGE / 4) ** 0.5)
LONG_HEAD = b"\x93NUMPY\x02\x00" + struct.pack("<L", HUGE)
FILES: dict[str, Callable[[], bytes]] = {
    "map.npz": lambda: npz((SIDE, SIDE)),
    "mask.npz": lambda: npz((HUGE // 4, 1)),
    "list.npz": lambda: npz((HUGE // 4,)),
    "head.npz": lambda: zip_member("depth.npy", deflate(HUGE, -15, LONG_HEAD), len(LONG_HEAD) + HUGE),
    "map.npy": lambda: npy_head((SIDE, SIDE)),
    "map.png": lambda: png(16, 0),
    "mask.png": lambda: png(8, 0),
    "photo.png": lambda: png(8, 2),
    "photo.tif": lambda: picture("TIFF", struct.pack("<HHLL", 256, 4, 1, 77), struct.pack("<HHLL", 256, 4, 1, 10**6)),
    "photo.jpg": lambda: picture("JPEG", struct.pack(">BHH", 8, 77, 77), struct.pack(">BHH", 8, 16000, 16000)),
    "stated.mcap": lambda: mcap(HUGE),
    "lying.mcap": lambda: mcap(100),
    "lying.zip": lambda: zip_member("a", deflate(HUGE, -15), 10),
    "a.safetensors": safetensors,
    "a.stl": lambda: bytes(80) + struct.pack("<L", 2**32 - 1) + bytes(500),
    "a.gltf": gltf,
    "a.ply": lambda: ply("ascii"),
    "b.ply": lambda: ply("binary_little_endian"),
    "a.off": lambda: b"OFF\n2000000000 2000000000 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "a.obj": lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4000000000\n",
}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, float]]:
    """The exit code and the peak of memory, MiB, of each reader; a process of its own reads each file."""
    folder = tmp_path_factory.mktemp("files")
    for name, make in FILES.items():
        (folder / name).write_bytes(make())
    with (folder / "map.npy").open("ab") as file:
        file.truncate(file.tell() + HUGE)  # a sparse file
    done = subprocess.run([sys.executable, "-c", CHILD, folder], capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_would_fill_the_memory_is_refused_without_it(measured, name):
    code, peak_mb = measured[name]
    assert code == 0
    assert peak_mb < MOST_MB
