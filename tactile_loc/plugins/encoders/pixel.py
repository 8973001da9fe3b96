"""The paper's baseline: contact shapes are binarised, averaged to coarse cells, and compared cell by cell."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import Capabilities, ComponentOptions, Encoder, Float32, SensorGeometry
from tactile_loc.plugin.helpers import PATCH_PX, average_patches, cut_patches

LEAST_SEEN = 0.5  # least seen share of a cell that counts


class PixelEncoder(Encoder):
    """Embeds a contact shape as the share of each coarse cell that is in contact. It needs no training."""

    capabilities = Capabilities(follows_press_depth=True)

    class Options(ComponentOptions):
        """`signal` chooses the compared signal: the binary contact mask, or the penetration as a share of the press."""

        cells: int = Field(default=20, ge=4, le=400, description="cells along the longer image side")
        signal: Literal["binary", "depth"] = Field(default="binary", description="contact mask, or penetration")

    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return embeddings (N, cells) of contact depths (N, H, W), metres, cut at `press_depth_m`.

        The squared distance between two embeddings is the mean squared difference of their cells. Unobserved pixels
        count as equal.
        """
        signal: Float32 = self._compute_signal(depth_m, press_depth_m)
        if not geometry.observed_mask.all():
            signal = np.where(geometry.observed_mask, signal, np.float32(0))
        height, width = geometry.shape
        down, across = _count_cells(geometry, self.options.cells)
        rows, columns = _make_averages(geometry.shape, down, across)
        # two products of large matrices are several times as fast as one small product for each shape
        lines: Float32 = (signal.reshape(-1, width) @ columns.T).reshape(len(signal), height, across)
        cells = lines.swapaxes(1, 2).reshape(-1, height) @ rows.T
        return cells.reshape(len(signal), across, down).swapaxes(1, 2).reshape(len(signal), down * across)

    def encode_seen(
        self, depth_m: Float32, seen: NDArray[np.bool_], press_depth_m: float, geometry: SensorGeometry
    ) -> tuple[Float32, Float32]:
        """Return embeddings (N, cells) of the seen pixels (N, H, W) of contact depths, and weights (N, cells).

        A cell's value is the average of its seen pixels. The cell counts if more than half of its area is seen.
        """
        unseen = np.float32(press_depth_m)
        embeddings = self.encode(np.where(seen, depth_m, unseen), press_depth_m, geometry)
        whole = self.encode(np.zeros((1, *geometry.shape), np.float32), press_depth_m, geometry)
        share = self.encode(np.where(seen, np.float32(0), unseen), press_depth_m, geometry) / np.maximum(whole, 1e-12)
        weights = (share > LEAST_SEEN).astype(np.float32)
        return np.where(weights > 0, embeddings / np.maximum(share, LEAST_SEEN), np.float32(0)), weights

    def encode_patches(self, patches: NDArray[np.uint8], press_depth_m: float) -> Float32:
        """Return the embeddings (N, cells) of places' patches (N, PATCH_PX, PATCH_PX), cut at `press_depth_m`.

        A compiled loop averages the pixels in contact. It gives what `encode` gives.
        """
        cells = self.options.cells
        if cells > PATCH_PX:
            return super().encode_patches(patches, press_depth_m)
        values = np.arange(256, dtype=np.uint8)
        signal = self._compute_signal(cut_patches(values, press_depth_m), press_depth_m)
        averages = average_patches(patches, signal, *_make_averages((PATCH_PX, PATCH_PX), cells, cells))
        return averages.reshape(len(patches), cells * cells)

    def _compute_signal(self, depth_m: Float32, press_depth_m: float) -> Float32:
        """Return the compared signal, unitless, of contact depths, metres, of any shape."""
        press = np.float32(press_depth_m)
        binary = self.options.signal == "binary"
        signal: Float32 = (depth_m < press).astype(np.float32) if binary else 1 - depth_m / press
        return signal


def _count_cells(geometry: SensorGeometry, longest: int) -> tuple[int, int]:
    """Return the number of cells down and across, with `longest` along the longer side of the field of view.

    The numbers depend only on the field of view. A touch and a bank with different resolutions thus have the same
    cells.
    """
    across_scale, down_scale = geometry.scale_at_surface
    down_m, across_m = geometry.height_px / down_scale, geometry.width_px / across_scale
    share = longest / max(down_m, across_m)
    down, across = (max(1, round(round(share * side, 6))) for side in (down_m, across_m))
    return down, across


def _make_averages(shape: tuple[int, int], down: int, across: int) -> tuple[Float32, Float32]:
    """Return matrices that average the rows and the columns of an image over cells, scaled for embeddings."""
    scale = np.float32(1 / np.sqrt(down * across))
    return _make_averaging(shape[0], down), np.multiply(scale, _make_averaging(shape[1], across), dtype=np.float32)


def _make_averaging(pixels: int, cells: int) -> NDArray[np.float32]:
    """Return a matrix (cells, pixels) that averages pixels over equal cells, weighted by each pixel's overlap."""
    edges = np.linspace(0, pixels, cells + 1)
    left, right = np.arange(pixels), np.arange(pixels) + 1.0
    overlap = np.minimum(edges[1:, None], right) - np.maximum(edges[:-1, None], left)
    return (np.clip(overlap, 0, None) * (cells / pixels)).astype(np.float32)
