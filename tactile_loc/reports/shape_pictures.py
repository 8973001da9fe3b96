"""Contact shapes and their differences as small pictures: inline SVG with a scale in mm around an indexed PNG."""

from __future__ import annotations

import base64
import io

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing import ContactShape, SensorGeometry
from tactile_loc.drawing.pictures import extent_mm
from tactile_loc.reports.markup import escape
from tactile_loc.reports.scene3d import number, outlines_mm, round_values

DEPTHS, DIFFERENCES = "viridis", "RdBu_r"
EMPTY, UNSEEN, FIRST = 0, 1, 2  # places in the palette: transparent, dim, and the first colour
UNSEEN_RGBA = (128, 136, 148, 90)
MOST_APART = 0.25  # of the press depth: where the colours of differences end
EQUAL = 0.04  # of that: differences below are drawn as none


def shape_png(shape: ContactShape, geometry: SensorGeometry) -> str:
    """Return a contact shape (H, W) as a data URI: depth from full penetration, transparent without contact."""
    share = shape.depth_m / np.float32(shape.press_depth_m)
    return _png(share, shape.contact, geometry.observed_mask, DEPTHS)


def difference_png(made: ContactShape, observed: ContactShape, geometry: SensorGeometry) -> str:
    """Return by how much deeper `made` presses than `observed` (H, W) as a data URI: red deeper, blue less deep.

    The colours end at MOST_APART of the press depth; where both agree it is transparent.
    """
    deeper = (observed.depth_m - made.depth_m) / np.float32(MOST_APART * observed.press_depth_m)
    return _png(0.5 + 0.5 * deeper, np.abs(deeper) > EQUAL, geometry.observed_mask, DIFFERENCES)


def shape_svg(picture: str, geometry: SensorGeometry, outline: str, label: str, ticks: bool = False) -> str:
    """Return a picture (a data URI) as SVG in mm on the sensing surface, with an outline (a path) and a scale.

    With `ticks` the borders are numbered, else a bar shows a round length. `label` says what it is to those who cannot
    see it.
    """
    left, right, bottom, top = extent_mm(geometry)
    width, height = right - left, bottom - top
    pad = (0.13 * width, 0.02 * width, 0.12 * width) if ticks else (0.005 * width,) * 3
    box = f"{left - pad[0]:.3f} {top - pad[1]:.3f} {width + pad[0] + pad[1]:.3f} {height + pad[1] + pad[2]:.3f}"
    size = f'x="{left:.3f}" y="{top:.3f}" width="{width:.3f}" height="{height:.3f}"'
    parts = [
        f'<svg class="shape" viewBox="{box}" role="img" aria-label="{escape(label)}"><rect class="gel" {size}/>',
        f'<image {size} preserveAspectRatio="none" href="{picture}"/>',
        f'<path class="outline" d="{outline}"/><rect class="frame" {size}/>',
        _ticks(left, right, top, bottom) if ticks else _bar(left, bottom, width),
    ]
    return "".join([*parts, "</svg>"])


def outline_path(shape: ContactShape, geometry: SensorGeometry) -> str:
    """Return the border of a contact (H, W) as an SVG path in mm on the sensing surface."""
    lines = outlines_mm(shape, geometry)
    return "".join("M" + "L".join(f"{x:.2f} {y:.2f}" for x, y, _ in line) for line in lines)


def gradient(name: str, steps: int = 9) -> str:
    """Return a colour scale as CSS, from its low end on the left to its high end on the right."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return f"linear-gradient(to right, {', '.join(to_hex(c) for c in colormaps[name](np.linspace(0, 1, steps)))})"


def photo_png(image: NDArray[np.uint8]) -> str:
    """Return a photo (H, W, 3) as a data URI."""
    from PIL import Image

    return data_uri(Image.fromarray(image))


def data_uri(image: object, **options: object) -> str:
    """Return a PIL image as a PNG data URI."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True, **options)  # type: ignore[attr-defined]
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _png(share: NDArray[np.floating], shown: NDArray[np.bool_], observed: NDArray[np.bool_], colours: str) -> str:
    """Shares (H, W), 0 to 1, in colours where they are shown."""
    from matplotlib import colormaps
    from PIL import Image

    steps = 256 - FIRST
    index = FIRST + np.clip(share * (steps - 1), 0, steps - 1).round().astype(np.uint8)
    index = np.where(observed, np.where(shown, index, EMPTY), UNSEEN).astype(np.uint8)
    palette = (255 * colormaps[colours](np.linspace(0, 1, steps))[:, :3]).round().astype(np.uint8)
    image = Image.fromarray(index)
    image.putpalette([0, 0, 0, *UNSEEN_RGBA[:3], *palette.ravel().tolist()])
    return data_uri(image, transparency=bytes([0, UNSEEN_RGBA[3], *[255] * steps]))


def _ticks(left: float, right: float, top: float, bottom: float) -> str:
    """Numbers along the left and the lower border, mm."""
    size = 0.042 * (right - left)
    parts = [f'<g class="ticks" font-size="{size:.3f}">']
    for x in round_values(left, right):
        parts.append(f'<path d="M{x:g} {bottom:.3f}v{0.3 * size:.3f}"/>')
        parts.append(_text(x, bottom + 1.35 * size, number(x)))
    for y in round_values(top, bottom):
        parts.append(f'<path d="M{left:.3f} {y:g}h{-0.3 * size:.3f}"/>')
        parts.append(_text(left - 0.5 * size, y + 0.35 * size, number(y), "end"))
    x, y, edge = 0.5 * (left + right), 0.5 * (top + bottom), left - 2.4 * size
    parts.append(_text(x, bottom + 2.5 * size, "x (mm)"))
    parts.append(_text(edge, y, "y (mm)", more=f' transform="rotate(-90 {edge:.3f} {y:.3f})"'))
    return "".join([*parts, "</g>"])


def _text(x: float, y: float, text: str, anchor: str = "middle", more: str = "") -> str:
    return f'<text x="{x:.3f}" y="{y:.3f}" text-anchor="{anchor}"{more}>{text}</text>'


def _bar(left: float, bottom: float, width: float) -> str:
    """A bar of a round length in the lower left corner."""
    length, size = _round_length(width / 4), 0.075 * width
    x, y = left + 0.05 * width, bottom - 0.05 * width
    return (
        f'<g class="bar" font-size="{size:.3f}"><path d="M{x:.3f} {y:.3f}h{length:g}"/>'
        f'<text x="{x:.3f}" y="{y - 0.35 * size:.3f}">{length:g} mm</text></g>'
    )


def _round_length(about_mm: float) -> float:
    """The round length that is nearest below, or 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(about_mm))
    return float(max(k * power for k in (1, 2, 5) if k * power <= about_mm * 1.0001))
