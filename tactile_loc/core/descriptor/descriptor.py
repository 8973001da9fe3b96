"""The descriptor: a place and a touch that shows it have similar unit vectors, whatever the yaw, the gel and the press.

It was trained by contrast (Oord et al., 2018) on generated parts, by `benchmarks/train_descriptor.py`. There are two
networks, because a touch shows only a part of a place: one for places, and a larger one for touches.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.descriptor.features import encode_places, encode_touch
from tactile_loc.core.descriptor.network import Tower
from tactile_loc.core.sensing.touch import Touch

Float32 = NDArray[np.float32]

WEIGHTS = "descriptor.safetensors"
PLACES = "keys"  # the name of the network of places in the weights
STEPS = 127  # of a vector's component from 0 to 1, if it is stored as a whole number
AT_ONCE = 256  # places that are described together
SHARPEST = 0.01  # least temperature of the training


class Descriptor:
    """Computes vectors of places and touches from trained weights, the content of a safetensors file.

    `digest` identifies the network of places, so stored vectors of places stay valid if only that of touches changes.
    """

    def __init__(self, content: bytes) -> None:
        from safetensors.numpy import load

        stored = load(content)
        weights = {name: array.astype(np.float32) for name, array in stored.items()}
        self._places, self._touches = Tower(weights, PLACES), Tower(weights, "queries")
        self.temperature = max(SHARPEST, float(weights["temperature"][0]))
        places = (name.encode() + stored[name].tobytes() for name in sorted(stored) if name.startswith(PLACES))
        self.digest = hashlib.sha256(b"".join(places)).hexdigest()

    @property
    def dimensions(self) -> int:
        """The length of a vector."""
        return self._places.dimensions

    def describe_places(self, patches: NDArray[np.uint8]) -> Float32:
        """Return the unit vectors (N, D) of places with patches (N, PATCH_PX, PATCH_PX): see `Places`."""
        vectors = np.empty((len(patches), self.dimensions), np.float32)
        for start in range(0, len(patches), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            vectors[some] = self._places(encode_places(patches[some]))
        return vectors

    def describe_in_steps(self, patches: NDArray[np.uint8]) -> NDArray[np.int8]:
        """Return the vectors (N, D) of places times STEPS, rounded."""
        return np.rint(STEPS * self.describe_places(patches)).astype(np.int8)

    def describe_touch(self, touch: Touch) -> Float32:
        """Return the unit vector (D,) of a touch with depths."""
        # numba takes a while to import
        from tactile_loc.core.places.rotated_patches import find_anchor, rotate_patches

        press_m = touch.press_depth_m
        depth_m, seen = rotate_patches(touch, *find_anchor(touch), np.zeros(1), touch.find_known(press_m))
        vector: Float32 = self._touches(encode_touch(depth_m, seen, press_m))[0]
        return vector


@cache
def load_descriptor() -> Descriptor:
    """Return the descriptor with the weights that come with the package."""
    return Descriptor(files("tactile_loc.data").joinpath(WEIGHTS).read_bytes())
