"""Helpers for tests of libraries: a grid with few directions, and the content of a library's files."""

from pathlib import Path

from tactile_loc_library.record import PlaceGrid

FEW = PlaceGrid("whole", {"directions": 100})
NAMES = tuple(f"part-{k}" for k in range(6))


def read_files(path: Path) -> dict[str, bytes]:
    """All files of a library, by path, except the lock."""
    files = [file for file in sorted(path.rglob("*")) if file.is_file() and file.name != ".lock"]
    return {str(file.relative_to(path)): file.read_bytes() for file in files}


def flip(path: Path, position: int) -> None:
    """Damage one byte of a file."""
    content = bytearray(path.read_bytes())
    content[position] ^= 1
    path.write_bytes(content)
