"""The stage in which a sensor learns to read images: once for its presses and options, resumed when interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tactile_loc.calibration.calibrate import calibrate
from tactile_loc.calibration.estimator import (
    GelEstimator,
    Image,
    LabelledPresses,
    estimator_class,
    estimator_options,
)
from tactile_loc.calibration.presses import TABLE, PressFolder
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing import SensorGeometry
from tactile_loc.store.keys import StageKey, hash_arrays, hash_file
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace, WorkspaceCheckpoints

STAGE_VERSION = 2
WEIGHTS, RECORD = "estimator.safetensors", "held-out"


def calibrate_stage(
    presses: PressFolder, folder: Path, estimator: str, options: dict[str, Any], seed: int, store: StageStore,
    progress: Progress,
) -> tuple[GelEstimator, dict[str, Any]]:  # fmt: skip
    """Calibrate with a folder of presses, or find what was; return the estimator and the record of its errors."""
    inputs = {
        "table": hash_file(folder / TABLE), "images": [hash_arrays(image=image) for image in presses.images],
        "meshes": [hash_file(row.mesh) for row in presses.rows if row.kind == "mesh"],
        "background": hash_arrays(image=presses.background), "geometry": presses.geometry.describe(),
        "camera": presses.camera.describe(),
    }  # fmt: skip
    return learned(presses, presses.geometry, presses.background, inputs, estimator, options, seed, store, progress)


def learned(
    presses: LabelledPresses, geometry: SensorGeometry, background: Image, inputs: dict[str, Any], estimator: str,
    options: dict[str, Any], seed: int, store: StageStore, progress: Progress,
) -> tuple[GelEstimator, dict[str, Any]]:  # fmt: skip
    """Calibrate with presses, or find what was; `inputs` (JSON values) identifies them and the sensor."""
    kind = estimator_class(estimator)
    chosen = estimator_options(kind, options)
    described: dict[str, Any] = {"estimator": estimator, "options": chosen.model_dump(mode="json"), "seed": seed}
    key = StageKey("calibration", STAGE_VERSION, {**inputs, **described})

    def learn(work: Workspace) -> None:
        checkpoints = WorkspaceCheckpoints(work)
        done = calibrate(presses, geometry, background, estimator, options, seed, progress, checkpoints)
        work.save_file(WEIGHTS, done.estimator.save)
        work.save_json(RECORD, done.record())

    artifact = store.build(key, learn)
    made = kind(geometry, background, chosen)
    made.load(artifact.file(WEIGHTS))
    return made, artifact.json(RECORD)
