"""Disks that are small, or can only be read: file systems in memory; where they may not be mounted, limits instead."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

PAGE = 4096
ROOMY = 2**30


@dataclass(frozen=True)
class Disk:
    """A disk of its own, mounted at a folder."""

    folder: Path

    def set(self, *options: str) -> None:
        """Mount it again with other options, as "ro" or "size=1000000"."""
        _mounted("-o", ",".join(["remount", *options]), str(self.folder))

    def grow(self) -> None:
        """Make more room on it than anybody needs."""
        self.set(f"size={ROOMY}")


def can_mount() -> bool:
    """Whether this process may mount disks."""
    return os.geteuid() == 0 and subprocess.run(["unshare", "-m", "mount", "-t", "tmpfs", "none", "/mnt"],
                                                capture_output=True, check=False).returncode == 0  # fmt: skip


@contextmanager
def mounted(folder: Path, nbytes: int = ROOMY) -> Iterator[Disk]:
    """Mount a disk of so many bytes, rounded up to pages, at a folder; it is gone with the block."""
    folder.mkdir(parents=True, exist_ok=True)
    _mounted("-t", "tmpfs", "-o", f"size={-(-nbytes // PAGE) * PAGE}", "none", str(folder))
    try:
        yield Disk(folder)
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def _mounted(*words: str) -> None:
    subprocess.run(["mount", *words], check=True)


def limited(nbytes: int) -> tuple[str, ...]:
    """What stands before a command whose files may not become larger than so many bytes."""
    return ("bash", "-c", f'ulimit -f {max(1, nbytes // 1024)}; exec "$@"', "-")
