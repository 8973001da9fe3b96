"""An object's places, stored without loss in a sixth of their size, and their embeddings, built at first use."""

from functools import cached_property, partial
from typing import Any

import numpy as np

from tactile_loc.core.places.places import CAMERA, Places, split_patches
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.locate.sources.listed_grid import train_encoder
from tactile_loc.locate.sources.scoring import Scores
from tactile_loc.locate.sources.source import STAGE_VERSIONS, SourceSetup
from tactile_loc.simulate.place_training import PlaceProblem
from tactile_loc.slots.grid import GridSampler
from tactile_loc.store.artifact import Artifact
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

STAGE, STAGE_VERSION = "places", 1
FILE_FORMAT = 2  # increase if the same places are stored as other files
TRAINING_VERSION = 1  # version of how an encoder's training touches are drawn
ENCODED = 512  # places encoded at once, so that they fit in a processor's cache


def build_places(sampler: GridSampler, scene: Scene, store: StageStore, progress: Progress) -> tuple[Places, StageKey]:
    """Return the places of the scene's object, stored or built now, and their key."""
    key = make_places_key(sampler, scene)
    file_key = StageKey(STAGE, STAGE_VERSION, {**key.inputs, "format": FILE_FORMAT}, key.label)
    stored = store.build(file_key, lambda work: _save(sampler.places(scene.object, progress), work))
    return _load(stored), key


def load_places(setup: SourceSetup) -> tuple[Places, StageKey]:
    """Return the places that a source searches, and their key."""
    if setup.find_places is None:
        return build_places(setup.sampler, setup.scene, setup.store, setup.progress)
    return setup.find_places(), make_places_key(setup.sampler, setup.scene)


def make_places_key(sampler: GridSampler, scene: Scene) -> StageKey:
    """Return the key of the places of the scene's object.

    Everything that is made from the places is found by this key. The key does not contain the format of the files, so
    encoders that were trained on the places stay valid when only the format changes.
    """
    obj = scene.object
    return StageKey(STAGE, STAGE_VERSION, {"object": obj.describe(), "sampler": sampler.describe()}, obj.name)


def _save(places: Places, work: Workspace) -> None:
    runs, changes = split_patches(places.patches)
    work.save_array("T_place_object", places.T_place_object, packed=True)
    work.save_array("runs", runs, packed=True)
    work.save_array("changes", changes, packed=True)


def _load(stored: Artifact) -> Places:
    from tactile_loc.core.places.places import join_patches

    patches = join_patches(stored.load_array("runs"), stored.load_array("changes"))
    return Places(stored.load_array("T_place_object"), patches)


class PlaceBanks:
    """Encodes an object's places at each press depth, after training the encoder if necessary.

    `key` is the places' store key.
    """

    def __init__(self, setup: SourceSetup, places: Places, key: StageKey) -> None:
        self.setup, self.places, self.key, self.encoder = setup, places, key, setup.encoder

    @property
    def encoder_key(self) -> StageKey | None:
        """The store key of the encoder's weights; None if the encoder needs no training."""
        if not self.encoder.capabilities.needs_training:
            return None
        scene = self.setup.scene
        inputs: dict[str, Any] = {
            "places": self.key.digest,
            "training": TRAINING_VERSION,
            "encoder": self.encoder.describe(),
            "sensor": scene.geometry.describe(),
            "renderer": scene.renderer.describe(),
        }
        return StageKey("encoder", STAGE_VERSIONS["encoder"], inputs, scene.object.name)

    @cached_property
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""
        setup = self.setup
        return train_encoder(
            self.encoder,
            self.encoder_key,
            lambda kept: PlaceProblem(self.places, setup.scene, setup.sampler, setup.progress, kept),
            setup.store,
            setup.scene.object.name,
        )

    def bank(self, press_depth_m: float) -> Scores:
        """Return the bank (N, D) of the places' patches, cut at `press_depth_m` metres.

        Only banks of trained encoders are stored, because a network encodes places more slowly than a disk reads a
        bank.
        """
        if not self.trained:
            return self._encode(press_depth_m)
        key = StageKey("bank", STAGE_VERSIONS["bank"], {"trained": self.trained, "press_depth_m": press_depth_m})
        stored = self.setup.store.build(key, lambda work: work.save_array("bank", self._encode(press_depth_m)))
        return np.asarray(stored.load_array("bank"))

    def mask_bank(self, press_depth_m: float) -> Scores:
        """Return the bank (N, D) of the places' contact at `press_depth_m` metres, with the depth 0 in contact."""
        return self._encode(press_depth_m, flat=True)

    def _encode(self, press_depth_m: float, flat: bool = False) -> Scores:
        encode = partial(self._encode_some, press_depth_m, flat)
        one_by_one = self.encoder.capabilities.needs_training  # a network has threads of its own
        starts = range(0, len(self.places), ENCODED)
        return np.concatenate(list(map(encode, starts) if one_by_one else map_in_threads(encode, starts)))

    def _encode_some(self, press_depth_m: float, flat: bool, start: int) -> Scores:
        some, press = slice(start, start + ENCODED), np.float32(press_depth_m)
        if not flat:
            return self.encoder.encode_patches(self.places.patches[some], press_depth_m)
        touching = self.places.depths(press_depth_m, some) < press
        return self.encoder.encode(np.where(touching, np.float32(0), press), press_depth_m, CAMERA)
