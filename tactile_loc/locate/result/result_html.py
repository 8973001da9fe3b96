"""A result as HTML, the form in which notebooks display it: the verdict, the touches, and a table of hypotheses."""

import html
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, format_pose
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.images import encode_png, make_png_url
from tactile_loc.io.shape_pictures import OUTLINE, paint_shape, read_colour
from tactile_loc.locate.result.hypothesis import Hypothesis
from tactile_loc.locate.result.verdict import Verdict

MOST_ROWS, MOST_TOUCHES = 5, 4
SIDE_PX = 96  # pixels along the long side of a picture
VERDICT_COLOURS = {  # readable on white and below white text, and different for colour-blind readers
    Verdict.CERTAIN: "#00795a",
    Verdict.AMBIGUOUS: "#b45309",
    Verdict.POOR_FIT: "#9b2c5f",
    Verdict.NOT_FOUND: "#9b2c5f",
    Verdict.NO_CONTACT: "#56606b",
}
CELL = 'style="text-align:left;padding:2px 10px"'


def write_html(summary: str, hypotheses: Sequence[Hypothesis], touches: Sequence[Touch], views: Sequence[View]) -> str:
    """Return a result as HTML: the summary, and the first hypotheses with the contacts that they predict.

    `summary` begins with the verdict. `views` are those of the touches. Without them, there are no pictures.
    """
    views = views[:MOST_TOUCHES]
    frame = "sensor" if hypotheses[0].T_base_object is None else "base"
    rows = [_write_heading(frame, views), *([_write_touches(views)] if views else [])]
    rows += [_write_hypothesis(k, h, views) for k, h in enumerate(hypotheses[:MOST_ROWS], 1)]
    hidden = _count_hidden(poses=(len(hypotheses), MOST_ROWS), touches=(len(touches), MOST_TOUCHES))
    return f"<div>{_write_summary(summary)}<table>{''.join(rows)}</table>{hidden}</div>"


def _write_summary(summary: str) -> str:
    first, *lines = summary.splitlines()
    verdict, _, meaning = first.partition(": ")
    colour = VERDICT_COLOURS[Verdict(verdict)]
    title = f'<strong style="color:{colour};font-size:120%">{html.escape(verdict)}</strong>: {html.escape(meaning)}'
    return "<br>".join([title, *map(html.escape, lines)])


def _write_heading(frame: str, views: Sequence[View]) -> str:
    names = [html.escape(view.touch.name) for view in views]
    words = ["", *names, "probability", "imprint IoU", f"x, y, z in the {frame} frame", "rotation about an axis"]
    return f"<tr>{''.join(f'<th {CELL}>{word}</th>' for word in words)}</tr>"


def _write_touches(views: Sequence[View]) -> str:
    pictures = [_draw(view.touch.thin_surface(SIDE_PX), *_thin(view)) for view in views]
    return _write_row(["observed", *pictures, "", "", "", ""])


def _write_hypothesis(rank: int, hypothesis: Hypothesis, views: Sequence[View]) -> str:
    T = hypothesis.T_sensor_object if hypothesis.T_base_object is None else hypothesis.T_base_object
    x, y, z, angle_deg, axis = format_pose(T)
    pictures = [_draw_prediction(view, hypothesis) for view in views]
    chances = [format_percent(hypothesis.probability), format_percent(hypothesis.imprint_iou)]
    return _write_row([str(rank), *pictures, *chances, f"{x}, {y}, {z} mm", f"{angle_deg}° about {axis}"])


def _write_row(cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<td {CELL}>{cell}</td>' for cell in cells)}</tr>"


def _count_hidden(**parts: tuple[int, int]) -> str:
    """Return in words what is not shown; `parts` are the numbers of things, and of those that are shown."""
    hidden = [f"{total - shown} of {total} {what}" for what, (total, shown) in parts.items() if total > shown]
    return f"not shown: {', '.join(hidden)}" if hidden else ""


def _thin(view: View) -> tuple[SensorGeometry, Bools]:
    """Return the sensor with few pixels, and which of them (H, W) the touch marks as contact."""
    geometry, touching = view.touch.thin(SIDE_PX)
    return geometry, touching.contact


def _draw_prediction(view: View, hypothesis: Hypothesis) -> str:
    """Draw the contact shape that a hypothesis predicts for a touch, with the outline of the observed contact."""
    geometry, observed = _thin(view)
    scene = replace(view.scene, geometry=geometry)
    made = scene.show_like(view.T_sensor_first @ hypothesis.T_sensor_object, view.touch)
    return _draw(made, geometry, observed)


def _draw(shape: ContactShape, geometry: SensorGeometry, observed: Bools) -> str:
    """Return an image element of a contact shape (H, W), with the outline of the observed contact (H, W)."""
    picture = paint_shape(shape, geometry)
    picture[_find_outline(observed)] = read_colour(OUTLINE)
    return f'<img alt="contact shape" width="{SIDE_PX}" src="{make_png_url(encode_png(picture))}">'


def _find_outline(contact: Bools) -> Bools:
    """Return the pixels (H, W) of a contact that have a neighbour without contact."""
    padded = np.pad(contact, 1, mode="edge")
    inside = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return np.asarray(contact & ~inside)
