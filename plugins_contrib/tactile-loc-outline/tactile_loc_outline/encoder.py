"""The outline encoder: the low frequencies of a map of signed distances to the contact's outline."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import Capabilities, ComponentOptions, Encoder, Float32, SensorGeometry

from tactile_loc_outline.distances import signed_distances

IMAGE_PX = 100  # approximate longer image side after downsampling; distances are smooth, so few pixels suffice


class OutlineEncoder(Encoder):
    """Embeds a contact as the low frequencies of a map of signed distances to the contact's outline.

    The embeddings of two contacts differ more if the contacts are farther apart. In contrast, the masks of two thin
    contacts that do not overlap differ by the same amount at any distance.
    """

    capabilities = Capabilities(follows_press_depth=True)

    class Options(ComponentOptions):
        """The reach and the resolution of the map."""

        reach_mm: float = Field(default=4.0, gt=0, description="distance at which the map is cut, mm")
        frequencies: int = Field(
            default=12, ge=1, le=64, description="number of half waves along the longer image side, from 0 on"
        )

    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return embeddings (N, D), unitless, of contact depths (N, H, W) in metres.

        Pixels at `press_depth_m` or deeper, and unobserved pixels, are not in contact. Without the omitted high
        frequencies, the squared distance between two embeddings is the mean squared difference of their maps, in units
        of the squared reach.
        """
        step = max(1, round(max(geometry.shape) / IMAGE_PX))
        thinned = geometry.subsample(step)
        contact = (depth_m[:, ::step, ::step] < np.float32(press_depth_m)) & thinned.observed_mask
        reach_m = self.options.reach_mm * 1e-3
        maps = signed_distances(contact, thinned.pixel_pitch_m, reach_m) / np.float32(reach_m)
        x, y = ((np.arange(0, pixels, step) + 0.5) / pixels for pixels in (geometry.width_px, geometry.height_px))
        kept = low_frequencies(geometry, self.options.frequencies)
        rows, columns = cosines(y, kept.shape[0]), cosines(x, kept.shape[1])
        partial = (maps.reshape(-1, len(x)) @ columns.T).reshape(len(maps), len(y), len(columns))
        return np.ascontiguousarray((rows @ partial)[:, kept])


def low_frequencies(geometry: SensorGeometry, below: int) -> NDArray[np.bool_]:
    """Return a mask (V, U) of the spatial frequencies to keep.

    Entry (v, u) stands for v half waves down and u half waves across the field of view. A kept wave vector is shorter
    than `below` half waves along the longer side. Therefore the resolution is the same in all directions, and does not
    depend on the number of pixels.
    """
    across_scale, down_scale = geometry.scale_at_surface
    sides_m = np.array([geometry.height_px / down_scale, geometry.width_px / across_scale])
    v, u = (np.arange(max(1, int(np.ceil(below * side)))) / side for side in sides_m / sides_m.max())
    kept: NDArray[np.bool_] = np.hypot(v[:, None], u) < below
    return kept


def cosines(places: NDArray[np.float64], count: int) -> NDArray[np.float32]:
    """Return the matrix (count, P) that computes the first `count` cosine coefficients of P samples.

    The samples are at `places` (P,), which lie evenly between 0 and 1. The waves are orthonormal if each sample has the
    weight 1 / P.
    """
    waves = np.cos(np.pi * np.arange(count)[:, None] * places) * np.sqrt(2.0)
    waves[0] = 1.0
    return (waves / len(places)).astype(np.float32)
