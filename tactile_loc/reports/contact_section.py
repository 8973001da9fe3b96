"""The touch, what each candidate would show instead, and the difference."""

from __future__ import annotations

from tactile_loc.drawing.pictures import millimetres, percent
from tactile_loc.locate.result_arrays import ResultArrays
from tactile_loc.locate.result_json import HypothesisRecord, ResultRecord
from tactile_loc.reports import shape_pictures as pictures
from tactile_loc.reports.markup import escape


def contact_section(record: ResultRecord, arrays: ResultArrays) -> str:
    """Return the section of the contact shapes as HTML."""
    names = [record.touch.name, *(touch.name for touch in record.other_touches)]
    press_mm = 1e3 * max(touch.shape.press_depth_m for touch in arrays.touches)
    apart = f"{pictures.MOST_APART * press_mm:.2f}"
    words = (f"\N{MINUS SIGN}{apart} and less", "pressed in less … more than the touch (mm)", f"+{apart} and more")
    scales = _scale(pictures.DEPTHS, ("0", "depth from full penetration (mm)", f"{press_mm:.2f}"))
    scales += _scale(pictures.DIFFERENCES, words)
    cards = "".join(_card(h, i, arrays) for i, h in enumerate(record.hypotheses))
    return (
        f'<div class="touches">{_touches(names, arrays)}<div class="words">'
        "<p>What each candidate would show (left), and how that differs from the touch (right). "
        "Red line: the outline of the observed contact.</p>"
        f'{scales}</div></div><div class="cards">{cards}</div>'
    )


def _touches(names: list[str], arrays: ResultArrays) -> str:
    parts = []
    for name, touch in zip(names, arrays.touches, strict=True):
        outline = pictures.outline_path(touch.shape, touch.geometry)
        picture = pictures.shape_png(touch.shape, touch.geometry)
        shown = pictures.shape_svg(picture, touch.geometry, outline, f"contact shape of {name}", ticks=True)
        parts.append(f"<figure>{shown}<figcaption>observed contact shape: {escape(name)}</figcaption></figure>")
        if touch.image is not None:
            photo = pictures.photo_png(touch.image)
            shown = pictures.shape_svg(photo, touch.geometry, outline, f"image of {name}", ticks=True)
            parts.append(f"<figure>{shown}<figcaption>image that it was estimated from</figcaption></figure>")
    return "".join(parts)


def _card(h: HypothesisRecord, number: int, arrays: ResultArrays) -> str:
    pairs = []
    for touch in arrays.touches:
        outline = pictures.outline_path(touch.shape, touch.geometry)
        made = touch.made(number)
        shape = pictures.shape_png(made, touch.geometry)
        differs = pictures.difference_png(made, touch.shape, touch.geometry)
        shown = pictures.shape_svg(shape, touch.geometry, outline, f"contact shape of candidate {h.rank}")
        apart = pictures.shape_svg(differs, touch.geometry, outline, f"difference of candidate {h.rank} to the touch")
        pairs.append(f'<div class="pair">{shown}{apart}</div>')
    off = "" if h.error_m is None else f", {millimetres(h.error_m)} off"
    numbers = f"{percent(h.probability)}, imprint IoU {100 * h.imprint_iou:.0f} %{off}"
    return (
        f'<div class="card" data-number="{number}" aria-selected="{str(number == 0).lower()}">'
        f"<h4>{h.rank} <span>{escape(numbers)}</span></h4>{''.join(pairs)}</div>"
    )


def _scale(colours: str, words: tuple[str, str, str]) -> str:
    shown = "".join(f"<span>{escape(word)}</span>" for word in words)
    return f'<div class="scale"><i style="background:{pictures.gradient(colours)}"></i><span>{shown}</span></div>'
