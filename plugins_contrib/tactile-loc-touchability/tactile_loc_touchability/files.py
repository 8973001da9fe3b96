"""The file `touchability.json`. SI units."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tactile_loc.commands import write_atomically

from tactile_loc_touchability.study import Study

NAME, SCHEMA_VERSION = "touchability.json", 1


def write_document(studies: Sequence[Study], out: Path) -> tuple[dict[str, Any], list[Path]]:
    """Write the shares of all studies, and their touches, to a folder; return the document without the touches."""
    obj = studies[0].localizer.object
    document = {
        "schema_version": SCHEMA_VERSION,
        "object": obj.name,
        "symmetry": str(obj.symmetry),
        "diameter_m": studies[0].diameter_m,
        "studies": [describe_study(study) for study in studies],
    }
    touches = [list_touches(study) for study in studies]
    text = json.dumps({**document, "touches": touches}, allow_nan=False)
    return document, [write_atomically(out / NAME, lambda path: path.write_text(text))]


def describe_study(study: Study) -> dict[str, Any]:
    """Return the sensor, the press and the shares of a study."""
    return {
        "sensor": study.localizer.config.sensor.name,
        "press_m": study.press_m,
        "noise": study.options.noise,
        "reached": study.presses.reached,
        "shares": study.list_shares(),
    }


def list_touches(study: Study) -> list[dict[str, Any]]:
    """Return the place of each touch and its result."""
    places = zip(study.presses.T_sensor_object, study.presses.places_m, study.rows, strict=True)
    return [{"T_sensor_object": T.tolist(), "place_m": place_m.tolist(), **row} for T, place_m, row in places]
