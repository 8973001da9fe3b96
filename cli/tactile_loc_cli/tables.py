"""A result as people read it: millimetres, degrees, per cent."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tactile_loc.core.geometry import axis_angle
from tactile_loc_cli.console import output

if TYPE_CHECKING:
    from tactile_loc.locate.result_json import HypothesisRecord, ResultRecord


def title(record: ResultRecord) -> str:
    """Return the picture's title: object, sensor, normalised entropy, error."""
    text = f"{record.object.name} on {_sensor(record)}: normalised entropy {record.normalised_entropy:.2f}"
    return text if record.errors is None else f"{text}, error {_mm(record.errors.best_m)} mm"


def pose_table(record: ResultRecord) -> None:
    """Print the hypotheses: the object's pose in the sensor frame."""
    from rich.table import Table

    touch = "simulated touch" if record.touch.path is None else record.touch.name
    table = Table(
        title=f"{record.object.name} in the frame of {_sensor(record)}, {touch}", title_justify="left", box=None
    )
    known = record.errors is not None
    for name in ("rank", "prob. %", "x mm", "y mm", "z mm", "turn deg", "about axis", "imprint IoU %"):
        table.add_column(name, justify="right", no_wrap=True)
    if known:
        table.add_column("error mm", justify="right", no_wrap=True)
    for hypothesis in record.hypotheses:
        table.add_row(*_cells(hypothesis))
    output().print(table)


def summary(record: ResultRecord) -> Iterator[str]:
    """Yield the lines below the table."""
    yield (
        f"normalised entropy: {record.normalised_entropy:.2f} (0: one pose is certain, 1: nothing is known), "
        f"{record.grid_poses} poses searched"
    )
    grid = record.configuration["grid"]
    if (grid["name"], grid["options"].get("face")) == ("face", "auto"):
        yield f"side searched: {_side(record)}, on which it rests lowest; another: -o grid.face=+z, all: --grid hopf"
    errors = record.errors
    if errors is not None:
        yield (
            f"error: {_mm(errors.best_m)} mm the best, {_mm(errors.best_listed_m)} mm the nearest of those listed, "
            f"{_mm(errors.closest_in_grid_m)} mm the nearest of the grid (RMS surface distance, symmetry regarded)"
        )
    yield "time: " + ", ".join(f"{stage} {_duration(s)}" for stage, s in record.seconds.items())


def _side(record: ResultRecord) -> str:
    """The object's side that touches, as the outward direction in its own frame that points into the sensor."""
    x, y, z = -np.array(record.hypotheses[0].T_sensor_object_grid)[2, :3] + 0.0
    return f"the object's side ({x:.2f}, {y:.2f}, {z:.2f})"


def _sensor(record: ResultRecord) -> str:
    sensor = record.configuration["sensor"]
    return Path(path).stem if (path := sensor["options"].get("path")) else str(sensor["name"])


def _cells(h: HypothesisRecord) -> list[str]:
    T = np.array(h.T_sensor_object)
    angle_deg, axis = axis_angle(T[:3, :3])
    cells = [
        str(h.rank), f"{100 * h.probability:.1f}", *(f"{1e3 * v:.2f}" for v in T[:3, 3]), f"{angle_deg:.1f}",
        "({:.3f}, {:.3f}, {:.3f})".format(*axis), f"{100 * h.imprint_iou:.0f}",
    ]  # fmt: skip
    return cells if h.error_m is None else [*cells, _mm(h.error_m)]


def _mm(length_m: float) -> str:
    value = 1e3 * length_m
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"


def _duration(seconds: float) -> str:
    """Return seconds as a person reads them: 12.3 ms, 4.5 s."""
    return f"{seconds:.1f} s" if seconds >= 1 else f"{1e3 * seconds:.1f} ms"
