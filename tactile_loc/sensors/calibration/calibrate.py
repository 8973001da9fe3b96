"""Calibrates a sensor: trains an estimator on most presses and measures its errors on the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.sensors.calibration.folder import WEIGHTS
from tactile_loc.sensors.calibration.labels import Chosen, Image, LabelledPresses, PressLabel
from tactile_loc.sensors.calibration.presses import TABLE, PressFolder
from tactile_loc.sensors.reading.estimator import CalibrationProblem, EstimatorRecipe, GelEstimator
from tactile_loc.sensors.reading.reading import Health, find_worst, measure_health, read_gel
from tactile_loc.store.keys import StageKey, hash_arrays, hash_file
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace, WorkspaceCheckpoints

HELD_OUT = 0.2  # share of the presses on which the errors are measured
FEWEST = 5  # fewest presses for a calibration: four for training and one held out
STAGE_VERSION, RECORD = 5, "held-out"
LOOKED_AT = 60  # largest number of presses for which the health is measured


@dataclass(frozen=True)
class PressErrors:
    """An estimator's errors for one press. Lengths are in metres; unknown errors are NaN.

    `slope_deg` is the mean absolute error of the surface's angles along x and y in the contact, degrees. It is NaN for
    an estimator without slopes. `depth_m` is the RMS error of the indentation in the contact. It is NaN if the label is
    not absolute. `shape_m` is the RMS error in the contact after the mean error is subtracted. `untouched_m` is the RMS
    of the estimated indentation where the gel is untouched.
    """

    slope_deg: float
    shape_m: float
    depth_m: float
    untouched_m: float


def average_errors(errors: Sequence[PressErrors]) -> dict[str, float]:
    """Return the mean of each error over the presses for which the error is known.

    Errors that are unknown for all presses are omitted.
    """
    found = {f.name: [getattr(e, f.name) for e in errors] for f in fields(PressErrors)}
    known = {name: [v for v in values if np.isfinite(v)] for name, values in found.items()}
    return {name: float(np.mean(values)) for name, values in known.items() if values}


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A trained estimator with its errors.

    `held_out` holds the numbers of the presses that were not used for training. `errors` are the estimator's errors on
    these presses. `usual` is the worst health of the training presses.
    """

    estimator: GelEstimator
    held_out: tuple[int, ...]
    errors: tuple[PressErrors, ...]
    usual: Health

    def record(self) -> dict[str, Any]:
        """Return the errors, the noise of the untouched gel (metres) and the usual health, as JSON values."""
        mean = average_errors(self.errors)
        held_out = {"presses": list(self.held_out), "mean": mean}
        return {"noise_m": mean.get("untouched_m", 0.0), "held_out": held_out, "health": self.usual.record()}


def calibrate(problem: CalibrationProblem, recipe: EstimatorRecipe) -> Calibrated:
    """Train an estimator on four fifths of a problem's presses, and measure its errors on the other presses.

    Raises CalibrationError when there are fewer than FEWEST presses.
    """
    presses = problem.presses
    if len(presses) < FEWEST:
        raise CalibrationError(f"there are only {len(presses)} presses; give at least {FEWEST}, better 30")
    made = recipe.make_estimator(problem.geometry, problem.background)
    learned, held_out = split(len(presses), recipe.seed)
    made.fit(replace(problem, presses=Chosen(presses, learned)))
    errors = tuple(measure_press(made, *presses.read_press(number)) for number in held_out)
    return Calibrated(made, held_out, errors, _measure_usual_health(made, presses, learned))


def _measure_usual_health(estimator: GelEstimator, presses: LabelledPresses, learned: Sequence[int]) -> Health:
    """Return the worst health of the training presses. It is measured for at most LOOKED_AT presses."""
    some = learned[:: -(-len(learned) // LOOKED_AT)]
    images = (presses.read_press(number)[0] for number in some)
    return find_worst(measure_health(i, estimator.untouched, estimator.read(i)[1], estimator.geometry) for i in images)


def split(count: int, seed: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Draw the held-out presses from `count` presses. Return the numbers of the training and the held-out presses.

    Both tuples are sorted.
    """
    drawn = np.random.default_rng(seed).permutation(count)
    few = max(1, round(HELD_OUT * count))
    return tuple(sorted(drawn[few:].tolist())), tuple(sorted(drawn[:few].tolist()))


def measure_press(estimator: GelEstimator, image: Image, label: PressLabel) -> PressErrors:
    """Return the errors of an estimator for one press."""
    indentation, slopes = read_gel(estimator, image, estimator.geometry.gel)
    off = indentation - label.indentation_m
    inside = off[label.contact]
    shape_m = _rms(inside - inside.mean()) if inside.size else np.nan
    depth_m = _rms(inside) if label.absolute else np.nan
    untouched_m = _rms(off[label.known & ~label.contact])
    known = label.contact & label.known
    slope_deg = np.nan
    if slopes is not None and known.any():
        slope_deg = float(np.degrees(np.abs(np.arctan(slopes[known]) - np.arctan(label.slope[known]))).mean())
    return PressErrors(slope_deg, shape_m, depth_m, untouched_m)


def _rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64)))) if values.size else np.nan


def calibrate_stage(
    presses: PressFolder, folder: Path, recipe: EstimatorRecipe, store: StageStore, progress: Progress
) -> tuple[GelEstimator, dict[str, Any]]:
    """Calibrate with a folder of presses, or load the stored result.

    Return the estimator and a record of its errors, as JSON values.
    """
    inputs = {
        "table": hash_file(folder / TABLE),
        "images": [hash_arrays(image=image) for image in presses.images],
        "meshes": [hash_file(row.mesh) for row in presses.rows if row.kind == "mesh"],
        "background": hash_arrays(image=presses.background),
        "geometry": presses.geometry.describe(),
        "camera": presses.camera.describe(),
        "fit": None if presses.fit is None else presses.fit.record(),
    }
    problem = CalibrationProblem(presses.geometry, presses.background, presses, progress)
    return learn_stage(problem, recipe, inputs, store)


def learn_stage(
    problem: CalibrationProblem, recipe: EstimatorRecipe, inputs: dict[str, Any], store: StageStore
) -> tuple[GelEstimator, dict[str, Any]]:
    """Calibrate with a problem's presses, or load the stored result.

    `inputs`, JSON values, identify the presses and the sensor in the store. Return the estimator and a record of its
    errors, as JSON values.
    """
    made = recipe.make_estimator(problem.geometry, problem.background)
    options = made.options.model_dump(mode="json")
    described: dict[str, Any] = {"estimator": recipe.estimator, "options": options, "seed": recipe.seed}
    key = StageKey("calibration", STAGE_VERSION, {**inputs, **described})

    def learn(work: Workspace) -> None:
        done = calibrate(replace(problem, checkpoints=WorkspaceCheckpoints(work)), recipe)
        work.save_file(WEIGHTS, done.estimator.save)
        work.save_json(RECORD, done.record())

    artifact = store.build(key, learn)
    made.load(artifact.find_file(WEIGHTS))
    return made, artifact.load_json(RECORD)
