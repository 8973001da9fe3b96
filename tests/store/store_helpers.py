"""Helpers for tests of the store: a stage of five pieces, and functions to inspect and damage its files."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc import StageKey, StageStore
from tactile_loc.store.workspace import Workspace

KEY = StageKey("bank", 1, {"grid": "abc", "step_m": 0.002})
PROJECT = Path(__file__).parents[2]


class Five:
    """Builds five pieces and their sum, counts the computed pieces, and can stop at a piece."""

    def __init__(self, stop_at: int | None = None, error: BaseException | None = None) -> None:
        self.stop_at, self.error = stop_at, error or KeyboardInterrupt()
        self.computed: list[int] = []

    def piece(self, i: int) -> np.ndarray:
        if i == self.stop_at:
            raise self.error
        self.computed.append(i)
        return np.random.default_rng(i).normal(size=(40, 3))

    def __call__(self, workspace: Workspace) -> None:
        pieces = []
        for i in range(5):
            piece = workspace.load(f"piece{i}", keep=i < 3)
            if piece is None:
                piece = self.piece(i)
                workspace.save_array(f"piece{i}", piece, keep=i < 3)
            pieces.append(piece)
        workspace.save_array("sum", np.sum(pieces, axis=0))
        workspace.save_json("meta", {"n": 5, "a": [1.5, None]})


def folder_of(store: StageStore, key: StageKey = KEY) -> Path:
    return store.root / key.stage / key.digest[:16]


def contents(path: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in path.iterdir() if file.name != "manifest.json"}


def forbidden(workspace: Workspace) -> None:
    raise AssertionError("the stage was built again")


def run_python(script: str, *arguments: object, **options: Any) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.Popen(command, env=environment, text=True, stdout=subprocess.PIPE, **options)


def reference(tmp_path: Path) -> dict[str, bytes]:
    return contents(StageStore(tmp_path / "reference").build(KEY, Five()).path)


def flip(name: str, position: int) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / name if name else folder
        content = bytearray(path.read_bytes())
        content[position] ^= 1
        path.write_bytes(content)

    return damage
