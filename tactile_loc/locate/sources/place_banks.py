"""The embeddings of an object's places, and the encoder trained on the places: stored, or made at first use."""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np

from tactile_loc.core.places.places import CAMERA, Places
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.runtime.turns import split_into_turns
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.locate.sources.listed_model import STAGE_VERSIONS, train_encoder
from tactile_loc.locate.sources.scoring import Scores
from tactile_loc.simulate.place_training import PlaceProblem
from tactile_loc.slots.encoder import Encoder
from tactile_loc.slots.grid import GridSampler
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore

TRAINING_VERSION = 1  # version of how an encoder's training touches are drawn
ENCODED = 512  # places encoded at once, so that they fit in a processor's cache
A_TURN = 8 * ENCODED  # places encoded in one turn


class PlaceBanks:
    """Encodes an object's places at each press depth, after training the encoder if necessary.

    `key` is the places' store key.
    """

    def __init__(
        self, places: Places, key: StageKey, scene: Scene, sampler: GridSampler, encoder: Encoder, store: StageStore,
        progress: Progress,
    ) -> None:  # fmt: skip
        self.places, self.key, self.scene, self.sampler = places, key, scene, sampler
        self.encoder, self.store, self.progress = encoder, store, progress

    @property
    def encoder_key(self) -> StageKey | None:
        """The store key of the encoder's weights; None if the encoder needs no training."""
        if not self.encoder.capabilities.needs_training:
            return None
        return StageKey("encoder", STAGE_VERSIONS["encoder"], {
            "places": self.key.digest, "training": TRAINING_VERSION, "encoder": self.encoder.describe(),
            "sensor": self.scene.geometry.describe(), "renderer": self.scene.renderer.describe(),
        }, self.scene.object.name)  # fmt: skip

    @cached_property
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""
        return train_encoder(
            self.encoder, self.encoder_key,
            lambda kept: PlaceProblem(self.places, self.scene, self.sampler, self.progress, kept), self.store,
            self.scene.object.name,
        )  # fmt: skip

    def bank(self, press_depth_m: float) -> Scores:
        """Return the bank (N, D) of the places' patches, cut at `press_depth_m` metres.

        Only banks of trained encoders are stored, because a network encodes places more slowly than a disk reads a
        bank.
        """
        if not self.trained:
            return self._encode(press_depth_m)
        key = StageKey("bank", STAGE_VERSIONS["bank"], {"trained": self.trained, "press_depth_m": press_depth_m})
        stored = self.store.build(key, lambda work: work.save_array("bank", self._encode(press_depth_m)))
        return np.asarray(stored.load_array("bank"))

    def mask_bank(self, press_depth_m: float) -> Scores:
        """Return the bank (N, D) of the places' contact at `press_depth_m` metres, with the depth 0 in contact."""
        return self._encode(press_depth_m, flat=True)

    def _encode(self, press_depth_m: float, flat: bool = False) -> Scores:
        from tactile_loc.core.runtime.compiled import map_in_threads  # numba takes a while to import

        encode = partial(self._encode_some, press_depth_m, flat)
        one_by_one = self.encoder.capabilities.needs_training  # a network has threads of its own
        encoded: list[Scores] = []
        for some in split_into_turns(len(self.places), A_TURN):
            starts = range(some.start, some.stop, ENCODED)
            encoded += map(encode, starts) if one_by_one else map_in_threads(encode, starts)
        return np.concatenate(encoded)

    def _encode_some(self, press_depth_m: float, flat: bool, start: int) -> Scores:
        some, press = slice(start, start + ENCODED), np.float32(press_depth_m)
        if not flat:
            return self.encoder.encode_patches(self.places.patches[some], press_depth_m)
        touching = self.places.depths(press_depth_m, some) < press
        return self.encoder.encode(np.where(touching, np.float32(0), press), press_depth_m, CAMERA)
