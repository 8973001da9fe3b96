"""An object's places, stored without loss in a sixth of their size."""

from __future__ import annotations

from tactile_loc.core.places.places import Places
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.slots.grid import GridSampler
from tactile_loc.store.artifact import Artifact
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

STAGE, STAGE_VERSION = "places", 1
FILE_FORMAT = 2  # increase if the same places are stored as other files


def build_places(sampler: GridSampler, scene: Scene, store: StageStore, progress: Progress) -> tuple[Places, StageKey]:
    """Return the places of the scene's object, stored or built now, and their key."""
    key = make_places_key(sampler, scene)
    file_key = StageKey(STAGE, STAGE_VERSION, {**key.inputs, "format": FILE_FORMAT}, key.label)
    stored = store.build(file_key, lambda work: _save(sampler.places(scene.object, progress), work))
    return _load(stored), key


def make_places_key(sampler: GridSampler, scene: Scene) -> StageKey:
    """Return the key of the places of the scene's object.

    Everything that is made from the places is found by this key. The key does not contain the format of the files, so
    encoders that were trained on the places stay valid when only the format changes.
    """
    obj = scene.object
    return StageKey(STAGE, STAGE_VERSION, {"object": obj.describe(), "sampler": sampler.describe()}, obj.name)


def _save(places: Places, work: Workspace) -> None:
    from tactile_loc.core.places.places import split_patches  # numba takes a while to import

    runs, changes = split_patches(places.patches)
    work.save_array("T_place_object", places.T_place_object, packed=True)
    work.save_array("runs", runs, packed=True)
    work.save_array("changes", changes, packed=True)


def _load(stored: Artifact) -> Places:
    from tactile_loc.core.places.places import join_patches

    patches = join_patches(stored.load_array("runs"), stored.load_array("changes"))
    return Places(stored.load_array("T_place_object"), patches)
