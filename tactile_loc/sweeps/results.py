"""The files that a sweep leaves: sweep.csv, .parquet, .md and .json, and two pictures."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tactile_loc.drawing.pictures import save_figure
from tactile_loc.evaluation.protocol import PROTOCOL_VERSION
from tactile_loc.locate.result_json import versions
from tactile_loc.store.files import write_atomically
from tactile_loc.sweeps.figures import draw_effects, draw_error_time
from tactile_loc.sweeps.kept import configuration
from tactile_loc.sweeps.pivot import markdown
from tactile_loc.sweeps.sweep import Sweep
from tactile_loc.sweeps.table import csv_text, write_parquet

SCHEMA_VERSION = 1


def write_sweep(out: Path, sweep: Sweep, line: str) -> list[Path]:
    """Write all results into the folder `out` and return their paths.

    Pivots and pictures are of the errors of `line`, one of the protocol's LINES; pictures are left out where there is
    nothing to draw. Raises OutputError.
    """
    rows = sweep.rows
    texts = {
        "csv": csv_text(rows),
        "md": markdown(sweep, line),
        "json": json.dumps(record(sweep, line), indent=1) + "\n",
    }
    written = [_write(out / f"sweep.{suffix}", text) for suffix, text in texts.items()]
    written.append(write_parquet(out / "sweep.parquet", rows))
    for name, draw in (("error-time", draw_error_time), ("effects", draw_effects)):
        figure = draw(sweep, line)
        path = out / f"{name}.png"
        if figure is None:
            path.unlink(missing_ok=True)  # of a sweep that had something to draw
        else:
            written.append(save_figure(path, figure))
    return written


def record(sweep: Sweep, line: str) -> dict[str, Any]:
    """Return everything as JSON values: plan, versions, builds of each stage, and each row with its settings."""
    configurations = {one.key: dict(configuration(one)) for one in sweep.combinations}
    return {
        "schema_version": SCHEMA_VERSION,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions(),
        "protocol_version": PROTOCOL_VERSION,
        "line": line,
        "plan": sweep.plan.describe(),
        "combinations": len(sweep.combinations),
        "failed": sweep.failed,
        "built": sweep.built,
        "rows": [{**row, "configuration": configurations[row["key"]]} for row in sweep.rows],
    }


def _write(path: Path, text: str) -> Path:
    return write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
