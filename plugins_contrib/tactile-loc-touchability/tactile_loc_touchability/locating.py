"""The job of a worker: simulate sets of touches of one object, locate each, and compare the results with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from tactile_loc import Localization, Localizer, RobotTouches, RunConfig, StageKey, StageStore, hash_code, make_noise
from tactile_loc.plugin import ObjectModel, Poses, TactileLocError, Touch, registry
from tactile_loc.plugin.helpers import invert

VERSION = 1  # increase it if the same job gets other rows
NOTHING = "no feature"  # instead of a verdict: the press shows no edge and no feature, so it cannot be located
LISTED = 10  # most poses of a result that are kept
AS_WELL = 0.02  # a pose explains the touches as well as the first one if its imprint IoU is lower by at most this
LOCATING = ("core", "slots", "bases", "simulate", "io", "sensors", "plugins", "locate", "evaluation")

Row = dict[str, Any]
Rows = tuple[float, ...]


@dataclass(frozen=True)
class LocatingSets:
    """Sets of presses to simulate and to locate, each set together.

    `sets` has for each set the poses T_sensor_object of its presses, 16 numbers each, and `press_m` is their depth,
    metres. Touches are drawn with a `noise` by a `renderer`, and `seed` is that of the noise.
    """

    store: Path
    config: RunConfig
    sets: tuple[tuple[Rows, ...], ...]
    press_m: float
    noise: str
    renderer: str
    seed: tuple[int, ...]
    about: str  # the object and the code, hashed

    @property
    def key(self) -> str:
        """A hash of all inputs of the rows."""
        asked: Row = {
            "about": self.about,
            "config": self.config.model_dump(mode="json"),
            "sets": self.sets,
            "press_m": self.press_m,
            "noise": self.noise,
            "renderer": self.renderer,
            "seed": self.seed,
        }
        return StageKey("touchability", VERSION, asked).digest[:16]

    def measure(self, obj: ObjectModel, store: StageStore) -> dict[str, Any]:
        """Return a row for each set: see `measure_set`."""
        localizer = _open(self.config.model_dump_json(), obj, store.root)
        renderer = registry().create("renderer", self.renderer, {})
        source = RobotTouches(obj, localizer.scene.geometry, renderer, noise=make_noise(self.noise))
        rows = []
        for number, some in enumerate(self.sets):
            rng = np.random.default_rng([*self.seed, number])
            poses = [np.reshape(one, (4, 4)) for one in some]
            drawn = [source.draw_touch(T, self.press_m, f"touch-{k}", rng) for k, T in enumerate(poses)]
            rows.append(measure_set(localizer, [touch for touch in drawn if isinstance(touch, Touch)]))
        return {"rows": rows}


@lru_cache(maxsize=4)
def _open(config: str, obj: ObjectModel, store: Path) -> Localizer:
    """Return a localizer, made once in each process."""
    return Localizer(RunConfig.model_validate_json(config), obj, StageStore(store))


def describe_all(obj: ObjectModel) -> str:
    """Return a hash of the object, and of the code that decides rows."""
    code = {name: hash_code(f"tactile_loc.{name}") for name in LOCATING}
    return StageKey("touchability", VERSION, {"object": obj.describe(), "name": obj.name, **code}).digest


def measure_set(localizer: Localizer, touches: list[Touch]) -> Row:
    """Locate touches with known poses together; return the verdict, the pose error, and the wrong poses that fit.

    Without a touch or a pose, the error is None. `right` is the stated probability that the first pose is right.
    `rivals` are the listed poses that are wrong and explain the touches as well as the first pose. Each is the motion
    of the object, 16 numbers, from its true pose to the wrong one, in the object's frame, with its probability.
    """
    nothing: Row = {"verdict": NOTHING, "error_m": None, "right": 0.0, "freedom": "", "rivals": []}
    if not touches:
        return nothing
    try:
        found = localizer.localize(touches, top=LISTED)
    except TactileLocError:
        return {**nothing, "verdict": "not found"}
    errors_m = found.measure_errors_m(localizer.object)
    assert errors_m is not None  # touches have true poses
    return {
        "verdict": str(found.verdict),
        "error_m": float(errors_m[0]),
        "right": 0.0 if found.outcome is None else found.outcome.right,
        "freedom": str(found.freedom),
        "rivals": list_rivals(found, errors_m > (found.tolerance.distance_m or 1e-3)),
    }


def list_rivals(found: Localization, wrong: np.ndarray) -> list[Row]:
    """Return the motions to the `wrong` hypotheses (K,) that explain the touches as well as the best one."""
    truth: Poses = invert(np.asarray(found.touch.T_sensor_object))
    best = max(h.imprint_iou for h in found.hypotheses)
    return [
        {"motion": (truth @ h.T_sensor_object).round(7).ravel().tolist(), "probability": h.probability}
        for h, one in zip(found.hypotheses, wrong, strict=True)
        if one and h.imprint_iou >= best - AS_WELL
    ]
