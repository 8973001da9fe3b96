"""The descriptor: a place and a touch that shows it have similar unit vectors, whatever the yaw, the gel and the press.

It was trained by contrast (Oord et al., 2018) on generated parts, by `benchmarks/train_descriptor.py`. There are two
networks, because a touch shows only a part of a place: one for places, and a larger one for touches. Their inputs are
polar features of contact shapes: heights on rings around the place, on ramps of several lengths. A rotation of the
contact shifts the features along the angles.
"""

import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin import Float32, Touch
from tactile_loc.plugin.helpers import PATCH_PX, PITCH_M, cut_patches, find_anchor, rotate_patches

WEIGHTS = "descriptor.safetensors"
PLACES = "keys"  # the name of the network of places in the weights
STEPS = 127  # of a vector's component from 0 to 1, if it is stored as a whole number
AT_ONCE = 256  # places that are described together
SHARPEST = 0.01  # least temperature of the training
STRIDES = (1, 2, 2)  # of the layers of a network
RADII_M = (np.arange(16) + 0.5) * 6.25e-4
ANGLES = 48
RAMPS_M = (1e-4, 2.5e-4, 6e-4, 1.5e-3)  # a height has the value 1 from the end of a ramp


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
        press_m = touch.press_depth_m
        depth_m, seen = rotate_patches(touch, *find_anchor(touch), np.zeros(1), touch.find_known(press_m))
        vector: Float32 = self._touches(encode_touch(depth_m, seen, press_m))[0]
        return vector


@cache
def load_descriptor() -> Descriptor:
    """Return the descriptor with the weights that come with the package."""
    return Descriptor(files("tactile_loc_library").joinpath(WEIGHTS).read_bytes())


class Tower:
    """Maps features (N, A, C) to unit vectors (N, D). The vectors hardly depend on a rotation of the contact."""

    def __init__(self, weights: Mapping[str, Float32], name: str) -> None:
        self.layers = []
        for k in range(len(STRIDES)):
            kernel = weights[f"{name}.{k}.weight"]  # (outputs, inputs, taps)
            matrix = np.ascontiguousarray(kernel.transpose(2, 1, 0).reshape(-1, len(kernel)))
            self.layers.append((kernel.shape[2], matrix, weights[f"{name}.{k}.bias"]))
        self.out = np.ascontiguousarray(weights[f"{name}.out.weight"].T), weights[f"{name}.out.bias"]

    @property
    def dimensions(self) -> int:
        """The length of a vector."""
        return len(self.out[1])

    def __call__(self, features: Float32) -> Float32:
        """Return the vectors (N, D) of features (N, A, C)."""
        x = features
        for (taps, matrix, bias), stride in zip(self.layers, STRIDES, strict=True):
            count, angles, channels = x.shape
            wrapped = np.concatenate([x[:, -(taps // 2) :], x, x[:, : taps // 2]], axis=1)
            windows = np.lib.stride_tricks.sliding_window_view(wrapped, taps, axis=1)[:, ::stride]
            rows = windows.transpose(0, 1, 3, 2).reshape(-1, taps * channels)
            x = np.maximum(rows @ matrix + bias, 0).reshape(count, angles // stride, -1)
        matrix, bias = self.out
        vectors: Float32 = np.concatenate([x.mean(axis=1), x.max(axis=1)], axis=1) @ matrix + bias
        vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-12))
        return vectors


def encode_places(patches: NDArray[np.uint8]) -> Float32:
    """Return the features (N, ANGLES, C) of the patches (N, PATCH_PX, PATCH_PX) of places."""
    sampled = _sample(cut_patches(patches, RAMPS_M[-1]))
    return _stack(_climb(sampled))


def encode_touch(depth_m: Float32, seen: NDArray[np.bool_], press_m: float) -> Float32:
    """Return the features (N, ANGLES, 2 C) of touches' patches (N, PATCH_PX, PATCH_PX), metres.

    The second half of the features states what is known. In contact, the height is known. Beside the contact, it is
    known to be at least the press depth, and a ramp is known if it is shorter than the press.
    """
    numbers, weights = _find_samples()
    press = np.float32(press_m)
    sampled = _sample(np.minimum(depth_m, press))
    nearest = np.take_along_axis(numbers, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    visible = seen.reshape(len(seen), -1)[:, nearest]
    touched = sampled < press * np.float32(1 - 1e-6)
    values = [value * visible for value in _climb(sampled)]
    known = [(visible & (touched | (press >= ramp))).astype(np.float32) for ramp in RAMPS_M]
    return _stack(values + known)


def _sample(images: Float32) -> Float32:
    """Return images (N, PATCH_PX, PATCH_PX) at the polar samples (N, rings * ANGLES)."""
    numbers, weights = _find_samples()
    sampled: Float32 = np.einsum("nsk,sk->ns", images.reshape(len(images), -1)[:, numbers], weights)
    return sampled


def _climb(sampled: Float32) -> list[Float32]:
    """Return heights, metres, on each ramp, 0 to 1."""
    return [np.minimum(sampled / np.float32(ramp), 1) for ramp in RAMPS_M]


def _stack(planes: list[Float32]) -> Float32:
    """Return planes (N, rings * ANGLES) as features (N, ANGLES, planes * rings)."""
    stacked = np.stack(planes, axis=1).reshape(len(planes[0]), len(planes) * len(RADII_M), ANGLES)
    return np.ascontiguousarray(stacked.swapaxes(1, 2))


@cache
def _find_samples() -> tuple[NDArray[np.int64], Float32]:
    """Return the numbers (S, 4) and weights (S, 4) of the pixels between which each polar sample is interpolated."""
    angles = 2 * np.pi * np.arange(ANGLES) / ANGLES
    x, y = (np.outer(RADII_M, f(angles)).ravel() / PITCH_M + PATCH_PX // 2 for f in (np.cos, np.sin))
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    right, below = x - column, y - row
    numbers = np.stack([(row + i) * PATCH_PX + column + j for i in (0, 1) for j in (0, 1)], axis=1)
    down, across = (1 - below, below), (1 - right, right)
    weights = np.stack([down[i] * across[j] for i in (0, 1) for j in (0, 1)], axis=1)
    return numbers, weights.astype(np.float32)
