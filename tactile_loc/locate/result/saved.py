"""The parts of a localisation, read back from `result.json` and `result.npz`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import invert, rotate_covariance
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.candidate import RefinedPose
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.locate.probability.conformal import PoseSet
from tactile_loc.locate.result.hypothesis import Agreement, Hypothesis
from tactile_loc.locate.result.result_arrays import NAME, ResultArrays, TouchArrays, read_arrays
from tactile_loc.locate.result.result_json import HypothesisRecord, ResultRecord, TouchRecord, read_record

JSON_NAME = "result.json"
Float64 = NDArray[np.float64]


def read_files(path: Path) -> tuple[ResultRecord, ResultArrays]:
    """Read both files of a result; `path` is their folder or the .json file.

    Raises ResultError if the files cannot be used.
    """
    path = path / JSON_NAME if path.is_dir() else path
    record = read_record(path)
    return record, read_arrays(path.with_name(NAME), record)


def build_object(record: ResultRecord, arrays: ResultArrays) -> ObjectModel:
    """Return the object with the stored surface, whose centroid lies on every axis of symmetry."""
    symmetry = SymmetryGroup.parse(record.object.symmetry, arrays.mesh.centroid_m)
    notes = tuple(record.object.notes)
    return ObjectModel(record.object.name, arrays.mesh, symmetry, notes, record.object.source)


def build_touches(records: Sequence[TouchRecord], arrays: Sequence[TouchArrays]) -> list[Touch]:
    """Return touches. Raises ValueError if the files have different numbers of touches."""
    return [_build_touch(*pair) for pair in zip(records, arrays, strict=True)]


def _build_touch(record: TouchRecord, arrays: TouchArrays) -> Touch:
    shape = ContactShape(
        arrays.shape.depth_m, arrays.shape.press_depth_m, record.indentation_m, record.indentation_std_m
    )
    T_base_sensor, T_true = _build_pose(record.T_base_sensor), _build_pose(record.T_sensor_object)
    touch = Touch(shape, arrays.geometry, record.name, T_base_sensor, T_true, image=arrays.image)
    if record.T_base_sensor_std_m is None or record.T_base_sensor_std_rad is None:
        return touch
    return dataclasses.replace(
        touch, T_base_sensor_std_m=record.T_base_sensor_std_m, T_base_sensor_std_rad=record.T_base_sensor_std_rad
    )


def build_posterior(record: ResultRecord, arrays: ResultArrays, obj: ObjectModel) -> PosePosterior:
    """Return the posterior over the stored poses, the most probable first."""
    grid = PoseGrid(arrays.T_sensor_object, PoseMetric(obj))
    return PosePosterior(grid, arrays.log_p, arrays.log_train, record.posterior_touches, record.elsewhere)


def build_hypotheses(record: ResultRecord, posterior: PosePosterior) -> Iterator[Hypothesis]:
    """Yield the hypotheses, each with the index of the nearest pose in the grid of the stored posterior."""
    T_base_sensor = _build_pose(record.touch.T_base_sensor)
    proposed = np.array([h.T_sensor_object_grid for h in record.hypotheses])
    for h, T_grid, index in zip(record.hypotheses, proposed, posterior.grid.nearest(proposed)[1], strict=True):
        yield Hypothesis(
            h.probability, T_grid, _build_refined(h, T_base_sensor), int(index), h.grid_poses, h.imprint_iou,
            tuple(h.imprint_ious), T_base_sensor, h.prior_nats,
        )  # fmt: skip


def _build_refined(h: HypothesisRecord, T_base_sensor: Float64 | None) -> RefinedPose:
    pose = RefinedPose(np.array(h.T_sensor_object), h.contact_iou, h.converged, h.iterations, _build_pose(h.covariance))
    if T_base_sensor is None or h.T_base_object is None:
        return pose
    T_sensor_base, C = invert(T_base_sensor), _build_pose(h.base_covariance)
    reported = None if C is None else rotate_covariance(C, T_sensor_base[:3, :3])
    return dataclasses.replace(
        pose, T_reported_object=T_sensor_base @ np.array(h.T_base_object), reported_covariance=reported
    )


def build_pose_set(record: ResultRecord) -> PoseSet | None:
    """Return the set that the hypotheses are, if a coverage was requested."""
    return None if record.pose_set is None else PoseSet(**record.pose_set.model_dump())


def build_agreement(record: ResultRecord) -> Agreement:
    """Return how the touches agree."""
    touches = [record.touch, *record.other_touches]
    best = tuple(one.best_imprint_iou for one in touches if one.best_imprint_iou is not None)
    outliers = tuple(number for number, one in enumerate(touches) if one.outlier)
    return Agreement(best, outliers, record.contradictory)


def _build_pose(rows: list[list[float]] | None) -> Float64 | None:
    return None if rows is None else np.array(rows)
