"""The page of a live run, and the page's state for each frame: image, contact shape, pose and uncertainty."""

import math
from typing import Any

import numpy as np

from tactile_loc.core.geometry.pose_words import format_pose_words
from tactile_loc.core.geometry.rigid import Floats, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.formatting import format_percent, show_name
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.result_arrays import reduce_mesh
from tactile_loc.locate.result.verdict import explain_verdict
from tactile_loc.reports import pictures, scene
from tactile_loc.reports.page import Page, Section
from tactile_loc.tracking.live import LiveResult
from tactile_loc.view.drawn_scene import DrawnSensor
from tactile_loc.view.pose_panel import choose_view

NUMBERS = (  # name of the element, label, meaning
    ("verdict", "verdict", "whether the pose can be trusted"),
    ("probability", "probability", "of this pose"),
    ("imprint", "imprint IoU", "how well the pose explains the touch"),
    ("place", "x, y, z (mm)", "of the object in the sensor's frame"),
    ("turn", "rotation", "from the sensor's frame"),
    ("rate", "rate", "frames per second"),
)
NOTHING = "-"


def make_live_page(localizer: Localizer, about: str) -> Page:
    """Return the page that shows frames as they arrive; `about` names the frames' source."""
    geometry, mesh = localizer.sensor.geometry, reduce_mesh(localizer.object.mesh)
    frame = pictures.ImageBorders.of(geometry)
    numbers = {"numbers": NUMBERS, "frame": frame}
    data = {
        "mesh": scene.pack_mesh(mesh),
        "pad": scene.build_pad(DrawnSensor(geometry)),
        "bounds": _compute_bounds(mesh, geometry),
        "camera": _place_camera(mesh, geometry, _place_above(mesh, geometry)),
    }
    title = f"{localizer.object.name}, live"
    return Page("live", title, about, [Section("now", "", numbers)], data, ["solids.js", "live.js"], connects=True)


def render_shape(result: LiveResult, localizer: Localizer) -> ContactShape | None:
    """Return the contact shape that a frame's pose predicts at the touch's press depth.

    Returns None if the frame has no pose or no touch.
    """
    touch, T = result.touch, result.located.T_sensor_object
    if touch is None or T is None:
        return None
    depths_m = localizer.scene.match_touch(touch).render_what_touch_shows(T[None], touch)
    return ContactShape(depths_m[0], touch.press_depth_m)


def describe_frame(result: LiveResult, made: ContactShape | None, localizer: Localizer) -> dict[str, Any]:
    """Return the page's state for a frame, as JSON values. `made` is the contact shape predicted by its pose."""
    geometry, touch = localizer.sensor.geometry, result.touch
    shape = None if touch is None else touch.contact_shape
    T = result.located.T_sensor_object
    image = result.frame.image
    return {
        "number": result.frame.number,
        "texts": _write_texts(result),
        "pictures": [
            None if image is None else pictures.encode_photo(image),
            None if shape is None else pictures.draw_shape(shape, geometry),
        ],
        "outline": "" if shape is None else pictures.trace_outline(shape, geometry),
        "made": "" if made is None else pictures.trace_outline(made, geometry),
        "contact": scene.join_lines(DrawnSensor(geometry, touch=touch).outlines_m),
        "touches": touch is not None,
        "T": None if T is None else scene.list_rows_mm(T),
        "camera": None if T is None else _place_camera(localizer.object.mesh, geometry, T),
    }


def _write_texts(result: LiveResult) -> dict[str, str]:
    """Return the text of each element of the page, by the element's name."""
    located, frame = result.located, result.frame
    iou = None if math.isnan(located.imprint_iou) else located.imprint_iou
    shares = {"probability": located.probability, "imprint": iou}
    return {
        "says": located.says or show_name(frame.name),
        "verdict": located.word,
        "verdict-more": explain_verdict(located.verdict),
        **{name: NOTHING if share is None else format_percent(share) for name, share in shares.items()},
        **_write_pose(located),
        "rate": f"{result.rate_hz:.1f} Hz" if result.rate_hz else NOTHING,
        "rate-more": f"{frame.number + 1} frames, {result.dropped} dropped for newer ones",
    }


def _write_pose(located: LocatedFrame) -> dict[str, str]:
    """Return texts that describe the object's pose and its standard deviations, in mm and degrees."""
    if located.T_sensor_object is None:
        return {"place": NOTHING, "place-more": "", "turn": NOTHING, "turn-more": ""}
    words = format_pose_words(located.T_sensor_object, located.std)
    std = "" if located.std is None else f"; std {words.turn_std} about x, y, z"
    return {
        "place": words.place,
        "place-more": words.place_std and f"std {words.place_std} mm",
        "turn": words.turn,
        "turn-more": f"about {words.axis}{std}",
    }


def _compute_bounds(mesh: TriangleMesh, geometry: SensorGeometry) -> list[list[float]]:
    """Return the ranges along x, y and z, in mm, that contain the sensor, and the object at any pose in contact."""
    x0, x1, y0, y1 = (1e3 * value for value in geometry.rectangle)
    diagonal_mm = 1e3 * float(np.linalg.norm(np.ptp(mesh.vertices_m, axis=0)))
    reach_mm, z = diagonal_mm + scene.MARGIN_MM, 1e3 * geometry.surface_m
    return [[x0 - reach_mm, x1 + reach_mm], [y0 - reach_mm, y1 + reach_mm], [z - scene.MARGIN_MM, z + reach_mm]]


def _place_above(mesh: TriangleMesh, geometry: SensorGeometry) -> Floats:
    """Return the pose (4, 4) of the unrotated object on the gel, for the view before the first result."""
    T = np.eye(4)
    T[:3, 3] = -mesh.vertices_m.mean(axis=0)
    T[2, 3] = geometry.surface_m - mesh.vertices_m[:, 2].min()
    return T


def _place_camera(mesh: TriangleMesh, geometry: SensorGeometry, T: Floats) -> dict[str, Any]:
    """Return a camera that sees the sensor, and the object at T (4, 4), metres."""
    housing = scene.build_pad(DrawnSensor(geometry))["housing"]
    corners = np.stack([housing[k] for k in "xyz"], axis=1)
    seen_mm = np.concatenate([1e3 * transform_points(T, mesh.vertices_m), corners])
    return scene.place_camera(seen_mm, _compute_bounds(mesh, geometry), choose_view(mesh, T, scene.ELEVATION_DEG))
