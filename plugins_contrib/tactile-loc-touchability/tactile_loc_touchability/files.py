"""The file `touchability.json`. SI units."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tactile_loc.commands import write_atomically

from tactile_loc_touchability.details import Findings
from tactile_loc_touchability.rivals import ConfusedPair
from tactile_loc_touchability.study import Study

NAME, SCHEMA_VERSION = "touchability.json", 1


def write_document(studies: Sequence[Study], found: Findings, answer: str, out: Path) -> tuple[dict[str, Any], Path]:
    """Write all results to a folder; return the document without the single touches, and the path of the file."""
    obj = studies[0].localizer.object
    document = {
        "schema_version": SCHEMA_VERSION,
        "object": obj.name,
        "symmetry": str(obj.symmetry),
        "diameter_m": studies[0].diameter_m,
        "answer": answer,
        "studies": [describe_study(study) for study in studies],
        "details_of": list(studies).index(found.study),
        "best": [
            {"places_m": found.study.presses.places_m[list(one.presses)].tolist(), **one.shares} for one in found.best
        ],
        "pairs": [describe_pair(pair) for pair in found.pairs],
        "features": [asdict(one) for one in found.features],
        "no_feature": found.no_feature,
    }
    text = json.dumps({**document, "touches": [list_touches(study) for study in studies]}, allow_nan=False)
    return document, write_atomically(out / NAME, lambda path: path.write_text(text))


def describe_pair(pair: ConfusedPair) -> dict[str, Any]:
    """Return a pair of poses, and the shares of touches that fit both and that tell them apart."""
    return {
        "T_object_moved": pair.motions.tolist(),
        "words": pair.words,
        "reason": pair.reason,
        "confused": float(pair.confused.mean()),
        "told": float(pair.told.mean()),
    }


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
