"""The report of a run: one touch, or several at once, and where the object is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from tactile_loc.core.geometry import axis_angle
from tactile_loc.drawing.pictures import millimetres, percent
from tactile_loc.io.toml import toml_text
from tactile_loc.locate.result_arrays import ResultArrays
from tactile_loc.locate.result_json import SCHEMA_VERSION, HypothesisRecord, ResultRecord
from tactile_loc.reports.contact_section import contact_section
from tactile_loc.reports.markup import details, escape, figure, preformatted, table, tiles, versions_table
from tactile_loc.reports.page import Page, Section
from tactile_loc.reports.run_data import run_data, side_sentence
from tactile_loc.reports.source import ResultError, Source

ALL = 0.999999  # of the probability: what is missing is rounding
COLUMNS = ("rank", "prob. (%)", "fit (%)", "x (mm)", "y (mm)", "z (mm)", "turn (°)", "about the axis")


def read_record(source: Source) -> ResultRecord:
    """Read result.json. Raises ResultError, in one sentence, when it cannot be used."""
    document = source.document()
    version = document.get("schema_version")
    if version != SCHEMA_VERSION:
        raise ResultError(
            f"{source.path} is of version {version}, and this tactile-loc reads version {SCHEMA_VERSION}; run it again"
        )
    try:
        return ResultRecord.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ResultError(f"{source.path} is damaged: {where}: {first['msg']}; run tactile-loc again") from error


def run_page(record: ResultRecord, arrays: ResultArrays) -> Page:
    """Return the page of a result."""
    data = run_data(record, arrays)
    sections = [
        Section("summary", "", tiles(_tiles(record)) + _notes(record)),
        Section("candidates", "Candidates", _candidates(record)),
        Section("contact", "Contact shapes", contact_section(record, arrays)),
        Section("distribution", "Distribution", _distribution(record, arrays, data)),
        Section("times", "Times", _times(record)),
        Section("made", "Made with", _made(record)),
    ]
    return Page(f"{record.object.name} on {sensor_name(record)}", _about(record), sections, data, ["run.js"])


def sensor_name(record: ResultRecord) -> str:
    """Return the sensor's name, or that of its file."""
    sensor = record.configuration.get("sensor", {})
    path = sensor.get("options", {}).get("path")
    return Path(path).stem if path else str(sensor.get("name", "a sensor"))


def _about(record: ResultRecord) -> str:
    touch = record.touch
    what = f"touch {touch.name}" if touch.path is not None else f"simulated touch, noise {touch.noise}"
    if record.other_touches:
        what = f"{1 + len(record.other_touches)} touches at once, the first: {touch.name}"
    pressed = f"pressed {1e3 * touch.press_depth_m:.2f} mm deep"
    return f"{what}, {pressed}; {record.grid_poses} poses searched; {record.created}"


def _tiles(record: ResultRecord) -> Iterator[tuple[str, str, str]]:
    best = record.hypotheses[0]
    T = np.array(best.T_sensor_object)
    angle_deg, axis = axis_angle(T[:3, :3])
    x, y, z = 1e3 * T[:3, 3]
    turned = "turned {:.1f}° about ({:.3f}, {:.3f}, {:.3f})".format(angle_deg, *axis)
    yield "best pose: x, y, z", f"{x:.2f}, {y:.2f}, {z:.2f} mm", f"of the object in the sensor's frame, {turned}"
    yield "normalised entropy", f"{record.normalised_entropy:.2f}", "0: one pose is certain, 1: nothing is known"
    yield (
        "imprint IoU",
        f"{100 * best.imprint_iou:.0f} %",
        "how well the best pose explains the touch, in depth and outline",
    )
    yield "probability", percent(best.probability), f"of the best candidate, {best.grid_poses} grid poses together"
    errors = record.errors
    if errors is not None:
        closest = f"RMS of surface; the nearest grid pose: {millimetres(errors.closest_in_grid_m)}"
        yield "error", millimetres(errors.best_m), closest


def _notes(record: ResultRecord) -> str:
    return "".join(f'<p class="note warning">{escape(note)}</p>' for note in record.object.notes)


def _candidates(record: ResultRecord) -> str:
    known = record.errors is not None
    header = [*COLUMNS, "error (mm)"] if known else list(COLUMNS)
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in header)
    rows = "".join(
        f'<tr class="pick" data-number="{i}" aria-selected="{str(i == 0).lower()}">'
        + "".join(f"<td>{escape(cell)}</td>" for cell in _cells(h))
        + "</tr>"
        for i, h in enumerate(record.hypotheses)
    )
    ghost = " Orange: the true pose." if record.touch.T_sensor_object is not None else ""
    caption = (
        f"The object on the sensor at the chosen pose, mm in the sensor's frame. Red: the observed contact.{ghost} "
        "Drag to turn, scroll to zoom."
    )
    return (
        '<div class="split list"><figure><p id="chosen" aria-live="polite"></p>'
        f'<div class="plotly tall3d" id="scene"></div><figcaption>{caption}</figcaption></figure><div>'
        '<p class="note">Choose a candidate to see it on the sensor. The order is that of the fit: how well the '
        "refined pose explains the touch. The probability is that of all grid poses around it.</p>"
        f'<div class="scroll"><table aria-label="candidates"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody>'
        "</table></div></div></div>"
    )


def _cells(h: HypothesisRecord) -> list[str]:
    T = np.array(h.T_sensor_object)
    angle_deg, axis = axis_angle(T[:3, :3])
    cells = [
        str(h.rank), f"{100 * h.probability:.1f}", f"{100 * h.imprint_iou:.0f}", *(f"{1e3 * v:.2f}" for v in T[:3, 3]),
        f"{angle_deg:.1f}", "({:.3f}, {:.3f}, {:.3f})".format(*axis),
    ]  # fmt: skip
    return cells if h.error_m is None else [*cells, f"{1e3 * h.error_m:.2f}"]


def _distribution(record: ResultRecord, arrays: ResultArrays, data: dict[str, Any]) -> str:
    kept = len(arrays.log_p)
    note = ""
    if kept < record.grid_poses:
        held = f"they hold {100 * arrays.mass:.3g} % of the probability"
        held = "the others have no probability" if arrays.mass > ALL else held
        note = f'<p class="note">Drawn are the {kept} most probable of {record.grid_poses} poses; {held}.</p>'
    surface = (
        "Where on the object the sensor's centre is: each pose counts at the point of the surface that is nearest to "
        f"it, spread by {data['surface']['spread_mm']:.2g} mm along the surface. Numbers: candidates. Lines: the axes "
        "of the object's frame, 10 mm."
    )
    one = data["side"]["kind"] == "one"
    left = figure("surface", surface, size="taller3d" if one else "tall3d")
    right = figure("modes", "Probability of each candidate, and how well it explains the touch once refined.")
    yaw = figure("yaw", "Probability by the turn about the sensor's z axis (yaw).", size="" if not one else "middle")
    side = f'<p class="note">{escape(side_sentence(data["side"]))}</p>'
    left += side if one else side + figure("side", "Probability by which side of the object faces the sensor.")
    return f'{note}<div class="split"><div>{left}</div><div>{right}{yaw}</div></div>'


def _times(record: ResultRecord) -> str:
    build = record.seconds.get("model")
    lead = "" if build is None else f"<p>The object's model was built or loaded in {build:.3g} s before, once.</p>"
    return lead + figure("times", "How long each stage of the localisation took.", size="short")


def _made(record: ResultRecord) -> str:
    rows = [(slot, record.configuration.get(slot, {}).get("name", ""), package)
            for slot, package in record.distributions.items()]  # fmt: skip
    obj = record.object
    size = " x ".join(f"{1e3 * v:.1f}" for v in obj.size_m)
    return (
        f"<p>{escape(obj.name)}: {size} mm, {obj.triangles} triangles, symmetry {escape(obj.symmetry)}, read from "
        f"{escape(obj.source)}.</p>"
        + table(["slot", "component", "package"], rows, left=3, label="components")
        + details("configuration (TOML, as --config takes it)", preformatted(toml_text(record.configuration)))
        + details("versions", versions_table(record.versions))
    )
