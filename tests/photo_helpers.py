"""Photos of a camera with a known map: stretched, tilted, or through a lens; and marker dots."""

import numpy as np
from scipy.ndimage import map_coordinates

from tactile_loc.core.sensing.photo_map import UNIT, Lens, PhotoMap, to_corners

PX = 80
CORNERS = UNIT * PX
BARREL = Lens(0.9 * PX, 0.9 * PX, PX / 2, PX / 2, (-0.2,))
MAPS = {
    "stretched": PhotoMap((96, PX), (PX, PX), to_corners(UNIT * [96, PX])),
    "tilted": PhotoMap((PX, PX), (PX, PX), ((6.0, 2.0), (74.0, 2.0), (80.0, 80.0), (0.0, 80.0))),
    "barrel": PhotoMap((PX, PX), (PX, PX), to_corners(CORNERS, BARREL), BARREL),
}


def photograph(image: np.ndarray, photo_map: PhotoMap) -> np.ndarray:
    """The photo of a camera, given the image (H, W, 3) of equal scale; the image's border continues beyond it."""
    width, height = photo_map.photo_px
    x, y = (part.ravel() + 0.5 for part in np.meshgrid(np.arange(width), np.arange(height)))
    column, row = photo_map.locate_in_image(np.stack([x, y], axis=1)).T - 0.5
    planes = [map_coordinates(image[..., c].astype(float), [row, column], order=3, mode="nearest") for c in range(3)]
    return np.clip(np.rint(np.stack(planes, axis=-1)), 0, 255).astype(np.uint8).reshape(height, width, 3)


def lattice(
    spacing_px: float, shape: tuple[int, int] = (160, 160), turn: float = 0.1, hexagonal: bool = False
) -> np.ndarray:
    """The places (N, 2) of dots whose middle is in the image, pixels."""
    n = np.arange(-2 * shape[0] // spacing_px, 2 * shape[0] // spacing_px)
    a, b = (v.ravel() for v in np.meshgrid(n, n))
    if hexagonal:
        a, b = a + 0.5 * (b % 2), b * np.sqrt(0.75)
    x = spacing_px * (np.cos(turn) * a - np.sin(turn) * b) + 3.3
    y = spacing_px * (np.sin(turn) * a + np.cos(turn) * b) + 7.7
    inside = (x > 0) & (x < shape[1]) & (y > 0) & (y < shape[0])
    return np.stack([x, y], axis=1)[inside]


def draw(image: np.ndarray, places: np.ndarray, diameter_px: float, opacity: float = 0.8) -> np.ndarray:
    """The image (H, W, 3) with soft dark dots at places (N, 2), pixels."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    light = np.ones(image.shape[:2])
    for px, py in places:
        light *= 1 - opacity * 0.5 * (1 - np.tanh((np.hypot(x - px, y - py) - diameter_px / 2) / 0.6))
    return np.rint(image * light[..., None]).astype(np.uint8)
