"""Pictures of a page as data URIs: contact shapes, their differences, and photos."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.io.images import make_png_url
from tactile_loc.view.drawn_scene import trace_outlines_m
from tactile_loc.view.pictures import compute_extent_mm
from tactile_loc.view.pose_panel import list_round_values

DEPTHS, DIFFERENCES = "viridis", "RdBu_r"
EMPTY, UNSEEN, FIRST = 0, 1, 2  # indices in the palette: transparent, dim, and the first colour
UNSEEN_RGBA = (128, 136, 148, 90)
MOST_APART = 0.25  # end of the colour scale for differences, as a share of the press depth
EQUAL = 0.04  # smaller differences, as a share of MOST_APART, are transparent


@dataclass(frozen=True)
class ImageBorders:
    """The borders of a sensor's image on the sensing surface, in mm; y points down."""

    left: float
    right: float
    bottom: float
    top: float

    @classmethod
    def of(cls, geometry: SensorGeometry) -> ImageBorders:
        """Return the frame of a sensor's images."""
        return cls(*compute_extent_mm(geometry))

    @property
    def width(self) -> float:
        """Distance from the left to the right border, mm."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Distance from the top to the bottom border, mm."""
        return self.bottom - self.top

    @property
    def ticks_x(self) -> list[tuple[float, str]]:
        """Positions, mm, and texts of the ticks along the lower border."""
        return [(x, write_number(x)) for x in list_round_values(self.left, self.right)]

    @property
    def ticks_y(self) -> list[tuple[float, str]]:
        """Positions, mm, and texts of the ticks along the left border."""
        return [(y, write_number(y)) for y in list_round_values(self.top, self.bottom)]

    @property
    def bar_mm(self) -> float:
        """Length of the scale bar, mm: 1, 2 or 5 times a power of ten, and at most a quarter of the width."""
        power = 10.0 ** np.floor(np.log10(self.width / 4))
        return float(max(k * power for k in (1, 2, 5) if k * power <= self.width / 4 * 1.0001))


def draw_shape(shape: ContactShape, geometry: SensorGeometry) -> str:
    """Return a picture of a contact shape (H, W) as a data URI.

    Colours show the depth from full penetration. Pixels without contact are transparent.
    """
    share = shape.depth_m / np.float32(shape.press_depth_m)
    return _encode_shares(share, shape.contact, geometry.observed_mask, DEPTHS)


def draw_difference(made: ContactShape, observed: ContactShape, geometry: SensorGeometry) -> str:
    """Return a picture of the difference between two contact shapes (H, W) as a data URI.

    Pixels are red where `made` is deeper than `observed`, and transparent where both agree. The colour scale ends at
    `MOST_APART` of the press depth.
    """
    deeper = (observed.depth_m - made.depth_m) / np.float32(MOST_APART * observed.press_depth_m)
    return _encode_shares(0.5 + 0.5 * deeper, np.abs(deeper) > EQUAL, geometry.observed_mask, DIFFERENCES)


def trace_outline(shape: ContactShape, geometry: SensorGeometry) -> str:
    """Return the outline of a contact (H, W) as an SVG path, in mm on the sensing surface."""
    lines = trace_outlines_m(shape, geometry)
    return "".join("M" + "L".join(f"{x:.2f} {y:.2f}" for x, y, _ in 1e3 * line) for line in lines)


def encode_photo(image: NDArray[np.uint8]) -> str:
    """Return a photo (H, W, 3) as a data URI."""
    from PIL import Image

    return _encode_image(Image.fromarray(image))


def write_gradient(name: str) -> str:
    """Return a colour scale as a CSS gradient, with low values on the left."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return f"linear-gradient(to right, {', '.join(to_hex(c) for c in colormaps[name](np.linspace(0, 1, 9)))})"


def _encode_shares(share: NDArray[np.floating], shown: Bools, observed: Bools, colours: str) -> str:
    """Return a picture of shares (H, W), 0 to 1, as a data URI.

    Pixels outside of `shown` (H, W) are transparent. Pixels outside of `observed` (H, W) are dim.
    """
    from matplotlib import colormaps
    from PIL import Image

    steps = 256 - FIRST
    index = FIRST + np.clip(share * (steps - 1), 0, steps - 1).round().astype(np.uint8)
    index = np.where(observed, np.where(shown, index, EMPTY), UNSEEN).astype(np.uint8)
    palette = (255 * colormaps[colours](np.linspace(0, 1, steps))[:, :3]).round().astype(np.uint8)
    image = Image.fromarray(index)
    image.putpalette([0, 0, 0, *UNSEEN_RGBA[:3], *palette.ravel().tolist()])
    return _encode_image(image, transparency=bytes([0, UNSEEN_RGBA[3], *[255] * steps]))


def _encode_image(image: Any, **options: Any) -> str:
    """Return a PIL image as a PNG data URI."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True, **options)
    return make_png_url(buffer.getvalue())


def write_number(value: float) -> str:
    """Return a number as text with a typographic minus sign."""
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")
