"""An object's places, stored without loss in a sixth of their size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.places import FAR, PATCH_PX, Places
from tactile_loc.core.slots.grid import GridSampler
from tactile_loc.core.slots.scene import Scene
from tactile_loc.store.artifact import Artifact
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

STAGE, STAGE_VERSION = "places", 1
FILE_FORMAT = 2  # increase if the same places are stored as other files


def build_places(sampler: GridSampler, scene: Scene, store: StageStore, progress: Progress) -> tuple[Places, StageKey]:
    """Return the places of the scene's object, stored or built now, and their key.

    Everything that is made from the places is found by this key. The key does not contain the format of the files, so
    encoders that were trained on the places stay valid when only the format changes.
    """
    obj = scene.object
    inputs = {"object": obj.describe(), "sampler": sampler.describe()}
    file_key = StageKey(STAGE, STAGE_VERSION, {**inputs, "format": FILE_FORMAT}, obj.name)
    stored = store.build(file_key, lambda work: _save(sampler.places(obj, progress), work))
    return _load(stored), StageKey(STAGE, STAGE_VERSION, inputs, obj.name)


def _save(places: Places, work: Workspace) -> None:
    runs, changes = split_patches(places.patches)
    work.save_array("T_place_object", places.T_place_object, packed=True)
    work.save_array("runs", runs, packed=True)
    work.save_array("changes", changes, packed=True)


def _load(stored: Artifact) -> Places:
    patches = join_patches(stored.load_array("runs"), stored.load_array("changes"))
    return Places(stored.load_array("T_place_object"), patches)


def split_patches(patches: NDArray[np.uint8]) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
    """Split patches (N, PATCH_PX, PATCH_PX) into two arrays that compress well: see `join_patches`.

    Three of four pixels show no surface. The others differ little from the pixel before.
    """
    seen = (patches != FAR).ravel()
    starts = np.flatnonzero(np.diff(seen, prepend=False))
    runs = np.diff(starts, prepend=0, append=seen.size).astype(np.uint32)
    return runs, np.diff(patches.ravel()[seen], prepend=np.uint8(0))


def join_patches(runs: NDArray[np.uint32], changes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the patches (N, PATCH_PX, PATCH_PX) that `split_patches` split.

    `runs` are the numbers of consecutive pixels without surface and with surface, in turn, beginning with pixels
    without surface. `changes` are the differences, modulo 256, between consecutive pixels with surface.
    """
    seen = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    patches = np.full(len(seen), FAR, np.uint8)
    patches[seen] = np.cumsum(changes, dtype=np.uint8)
    return patches.reshape(-1, PATCH_PX, PATCH_PX)
