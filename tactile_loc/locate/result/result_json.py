"""The keys of `result.json`: the result of a localisation, and all its inputs. SI units.

Each function turns a part of a result into its document, or back. `Localization` puts the parts together.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.lie import rotate_covariance
from tactile_loc.core.geometry.rigid import Floats, invert
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.candidate import RefinedPose
from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import TouchConfig
from tactile_loc.io.json_keys import Key, Keys, read_keys, write_keys
from tactile_loc.io.streams.records import read_document
from tactile_loc.locate.probability.conformal import PoseSet
from tactile_loc.locate.result.assessment import Assessment, PoseErrors
from tactile_loc.locate.result.freedom import FREEDOM, Freedom
from tactile_loc.locate.result.hypothesis import Agreement, Hypothesis, RefinedBy
from tactile_loc.locate.result.verdict import Outcome, Verdict

NAME = "result.json"
SCHEMA_VERSION = 5  # of result.json and result.npz; it increases if a key is removed or gets another meaning
AGAIN = "locate the touches again with `tactile-loc run`, which writes both files"

RESULT: Keys = {
    "schema_version": Key(
        "integer", "version of this format; it increases if a key is removed or gets another meaning"
    ),
    "created": Key("text", "date and time, UTC, ISO 8601"),
    "versions": Key("object", "versions of tactile-loc, Python and the installed libraries"),
    "configuration": Key(
        "object", "all settings, including defaults; `tactile-loc run --config` reads the same entries as TOML"
    ),
    "distributions": Key("object", "for each slot, the installed package of the chosen component"),
    "object": Key("object", "the object"),
    "touch": Key("object", "the touch, or the first of several; poses are in the frame of its sensor"),
    "other_touches": Key("list", "the other touches that were fused with `touch`"),
    "contradictory": Key(
        "true or false",
        "true if no pose found explains all touches; touches that contradict the others are marked `outlier`, unless "
        "it is unknown which touches are wrong",
    ),
    "left_out": Key("list", "touches that were left out, because they contradict the others"),
    "verdict": Key(
        "text", "whether the first hypothesis can be trusted: `certain`, `ambiguous`, `poor fit` or `not found`"
    ),
    "tolerance": Key("text", "the largest error of a right pose, as in the configuration: 1mm or 0.5mm,2deg"),
    "probability_within": Key(
        "number or null",
        "probability that the first hypothesis is within the tolerance of the true pose, 0 to 1; null if unknown",
    ),
    "error_quantile_m": Key(
        "number or null",
        "what the pose error of the first hypothesis does not exceed with 95 % probability: 0.3, 0.5, "
        "1, 2 or 3 mm, in m; null if it may be greater",
    ),
    "poor_touches": Key(
        "numbers", "numbers of the touches, from 0, that the first hypothesis explains worse than right poses do"
    ),
    "unexpected": Key(
        "true or false", "whether the prior makes the first hypothesis very improbable; then it is not certain"
    ),
    "freedom": Key("object", "what the touches leave open"),
    "next_step": Key("text", "what to do next, in words; empty if the verdict is certain"),
    "grid_poses": Key("integer", "number of scored poses; with the grid `whole`, of poses that the search found"),
    "elsewhere": Key("number", "probability that the true pose is near none of the scored poses; 0 for a listed grid"),
    "missed": Key("number", "probability that no hypothesis is within the tolerance of the true pose"),
    "normalised_entropy": Key(
        "number", "entropy / log(grid_poses): 0 if one pose is certain, 1 if all poses are equally probable"
    ),
    "posterior_touches": Key("integer", "number of touches behind the posterior, with those behind a prior"),
    "entropy_nats": Key("number", "Shannon entropy of the posterior, nats"),
    "refined_by": Key("object or null", "what refined the poses; null if unknown"),
    "hypotheses": Key("list", "distinct explanations, the best first"),
    "pose_set": Key("object or null", "the set that the hypotheses are; null unless a coverage was requested"),
    "errors": Key("object or null", "errors of the answer; null if the true pose is unknown"),
    "seconds": Key("object", "duration of each stage, s"),
}

OBJECT: Keys = {
    "name": Key("text", "the object's name"),
    "source": Key("text", "the mesh file that was read"),
    "size_m": Key("numbers", "size of the surface's bounding box along x, y, z of the object frame, m"),
    "triangles": Key("integer", "number of triangles of the surface"),
    "symmetry": Key("text", "the rotations that map the object onto itself, declared or detected"),
    "notes": Key("texts", "guesses and warnings from reading the mesh"),
}

TOUCH: Keys = {
    "name": Key("text", "the touch's name"),
    "path": Key("text or null", "the touch's file; null if the touch was simulated"),
    "noise": Key("text or null", "the noise of a simulated touch; null if the touch was read from a file"),
    "image_px": Key("numbers", "size of the contact shape (rows, columns), pixels"),
    "press_depth_m": Key("number", "press depth of the contact shape, m"),
    "indentation_m": Key("number", "how deep the object was pressed into the gel, m"),
    "T_base_sensor": Key("4 x 4 numbers or null", "the sensor's pose, m; null if unknown"),
    "T_base_sensor_std_m": Key(
        "number or null", "standard deviation of the error of `T_base_sensor` along each axis, m"
    ),
    "T_base_sensor_std_rad": Key("number or null", "the same about each axis, rad"),
    "indentation_std_m": Key(
        "number", "standard deviation of the indentation's error, m, if the sensor knows it; else 0"
    ),
    "depths_known": Key("true or false", "false for a contact mask, which has no depths"),
    "gel_law": Key(
        "text",
        "the law of the gel by which the touch was located: `rigid`, `layer`, or `outlined layer`, whose contact ends "
        "where the surface is steepest",
    ),
    "T_sensor_object": Key("4 x 4 numbers or null", "the true pose, m; null if unknown"),
    "best_imprint_iou": Key(
        "number or null", "with several touches: the best imprint IoU of any pose tried with this touch, 0 to 1"
    ),
    "outlier": Key("true or false", "whether the touch contradicts the other touches, which agree"),
}

HYPOTHESIS: Keys = {
    "rank": Key("integer", "1 for the most probable hypothesis"),
    "probability": Key("number", "probability of the hypothesis, 0 to 1"),
    "grid_poses": Key("integer", "number of grid poses that belong to the hypothesis"),
    "T_sensor_object_grid": Key("4 x 4 numbers", "the most probable grid pose of the hypothesis, m"),
    "T_sensor_object": Key("4 x 4 numbers", "the answer: the grid pose after refinement, m"),
    "imprint_iou": Key(
        "number",
        "imprint IoU, 0 to 1: how well the refined pose explains the touch in depth and outline; for several touches, "
        "the mean without outliers",
    ),
    "imprint_ious": Key("numbers", "imprint IoU with each touch: `touch`, then `other_touches`"),
    "prior_nats": Key("number", "log-weight of the prior at the answer, nats; 0 without a prior"),
    "contact_iou": Key(
        "number", "contact IoU from the refiner: how well the pose's contact area matches the observed one, 0 to 1"
    ),
    "converged": Key("true or false", "whether the refinement converged"),
    "iterations": Key("integer", "number of iterations of the refinement"),
    "covariance": Key(
        "6 x 6 numbers or null",
        "covariance of the answer's error, in the order and frame of ROS's PoseWithCovariance: x, y, z of the object "
        "frame's origin (m), rotations about the sensor's x, y, z axes (rad); null if unknown",
    ),
    "quaternion_xyzw": Key("numbers or null", "the rotation of `T_sensor_object` as a unit quaternion, scalar last"),
    "T_base_object": Key(
        "4 x 4 numbers or null",
        "the answer in the base frame, m; null if the sensor's pose is unknown. For one touch, it is `T_base_sensor` "
        "times `T_sensor_object`. For several, it averages the errors of the sensors' poses",
    ),
    "base_quaternion_xyzw": Key("numbers or null", "the rotation of `T_base_object` as a unit quaternion, scalar last"),
    "base_covariance": Key(
        "6 x 6 numbers or null",
        "covariance of the error of `T_base_object`, in the order and frame of ROS's PoseWithCovariance: x, y, z of "
        "the object frame's origin (m), rotations about the base's x, y, z axes (rad). It includes the errors of the "
        "sensors' poses; null if unknown",
    ),
    "error_m": Key(
        "number or null",
        "pose error: the largest displacement of any surface point, m; null if the true pose is unknown",
    ),
}

REFINED_BY: Keys = {
    "search": Key("text or null", "what improves the poses in the search of the whole object; null for a listed grid"),
    "poses": Key("text or null", "what refined the hypotheses; null if nothing did"),
    "touches": Key(
        "text or null",
        "how several touches were refined: `together`, or `alone` if the results of each touch alone were combined by "
        "their covariances; null for one touch",
    ),
    "covariances": Key("text or null", "what gave the covariances; null if nothing did"),
}

POSE_SET: Keys = {
    "coverage": Key("number", "the requested probability, 0 to 1"),
    "poses": Key("integer", "number of hypotheses in the set; they are the listed ones"),
    "radius_m": Key("number", "a hypothesis counts as the true pose if its pose error is at most this, m"),
    "elsewhere": Key(
        "true or false", "whether the set also contains `elsewhere`: the true pose may be none of the poses"
    ),
    "missed": Key("number", "predicted probability that the true pose is none of the poses found, 0 to 1"),
    "promised": Key("true or false", "whether the listed poses alone have the coverage"),
    "reason": Key("text", "why the listed poses alone do not have the coverage; empty if they do"),
    "level": Key("number", "total probability up to which poses are in the set, 0 to 1"),
    "examples": Key("integer", "number of simulated, held-out examples from which the level was computed"),
}

ERRORS: Keys = {
    "best_m": Key("number", "error of the first hypothesis, m"),
    "best_listed_m": Key("number", "smallest error of the listed hypotheses, m"),
    "closest_in_grid_m": Key("number", "error of the grid pose nearest to the true pose, m"),
}

PARTS: dict[str, tuple[str, Keys]] = {  # the objects in a document, with their meanings
    "object": ("The object that was located.", OBJECT),
    "touch": ("A touch that was located.", TOUCH),
    "hypotheses[]": ("One distinct explanation of the touches.", HYPOTHESIS),
    "freedom": ("What the touches leave open about the first hypothesis.", FREEDOM),
    "refined_by": ("What refined the poses: the name of a refiner, or `joint registration`.", REFINED_BY),
    "pose_set": ("A set of hypotheses that contains the true pose with a known probability.", POSE_SET),
    "errors": (
        "Pose errors: the largest displacement of any surface point, the least over the object's symmetries.",
        ERRORS,
    ),
}


def read_result(path: Path) -> dict[str, Any]:
    """Return the document in a result.json. Raises ResultError if the file cannot be used."""
    document = read_document(path)
    version = document.get("schema_version")
    if version != SCHEMA_VERSION:
        raise ResultError(f"{path} has version {version}, but this tactile-loc reads version {SCHEMA_VERSION}; {AGAIN}")
    try:
        return read_keys(RESULT, document)
    except ValueError as error:
        raise ResultError(f"{path} is damaged: {error}; {AGAIN}") from error


def write_object(obj: ObjectModel) -> dict[str, Any]:
    """Return the document of an object."""
    return write_keys(OBJECT, obj, size_m=obj.mesh.extents_m, triangles=len(obj.mesh.faces))


def read_object(document: Any, mesh: TriangleMesh) -> ObjectModel:
    """Return an object with its surface, whose centroid lies on every axis of symmetry. Raises ValueError."""
    keys = read_keys(OBJECT, document, "object")
    symmetry = SymmetryGroup.parse(keys["symmetry"], mesh.centroid_m)
    return ObjectModel(keys["name"], mesh, symmetry, tuple(keys["notes"]), keys["source"])


def write_touch(
    touch: Touch, source: TouchConfig, best_iou: float | None = None, outlier: bool = False
) -> dict[str, Any]:
    """Return the document of a touch, which was read or simulated as `source` states.

    `best_iou` and `outlier` state how it agrees with other touches.
    """
    placed = touch.T_base_sensor is not None
    return write_keys(
        TOUCH,
        touch,
        path=source.path,
        noise=source.noise if source.path is None else None,
        image_px=touch.geometry.shape,
        T_base_sensor_std_m=touch.T_base_sensor_std_m if placed else None,
        T_base_sensor_std_rad=touch.T_base_sensor_std_rad if placed else None,
        indentation_std_m=touch.contact_shape.indentation_std_m,
        depths_known=touch.has_depths,
        best_imprint_iou=best_iou,
        outlier=outlier,
    )


def read_agreement(touches: list[Any], contradictory: bool) -> Agreement:
    """Return how touches agree, from their documents. Raises ValueError."""
    keys = [read_keys(TOUCH, one, f"touch {number}") for number, one in enumerate(touches)]
    best = tuple(one["best_imprint_iou"] for one in keys if one["best_imprint_iou"] is not None)
    return Agreement(best, tuple(number for number, one in enumerate(keys) if one["outlier"]), contradictory)


def write_hypothesis(rank: int, hypothesis: Hypothesis, error_m: float | None) -> dict[str, Any]:
    """Return the document of a hypothesis; `error_m`, metres, is its pose error, if known."""
    return write_keys(HYPOTHESIS, hypothesis, rank=rank, error_m=error_m)


def read_hypotheses(documents: list[Any], T_base_sensor: Floats | None) -> tuple[Hypothesis, ...]:
    """Return hypotheses whose grid index is unknown, -1. `T_base_sensor` (4, 4), metres, is the first touch's.

    Raises ValueError.
    """
    if not documents:
        raise ValueError("hypotheses must not be empty")
    every = [read_keys(HYPOTHESIS, one, f"hypotheses.{number}") for number, one in enumerate(documents)]
    return tuple(
        Hypothesis(
            keys["probability"],
            np.array(keys["T_sensor_object_grid"], float),
            _read_refined(keys, T_base_sensor),
            -1,
            keys["grid_poses"],
            keys["imprint_iou"],
            tuple(keys["imprint_ious"]),
            T_base_sensor,
            keys["prior_nats"],
        )
        for keys in every
    )


def _read_refined(keys: dict[str, Any], T_base_sensor: Floats | None) -> RefinedPose:
    names = ("T_sensor_object", "covariance", "T_base_object", "base_covariance")
    T, covariance, T_base_object, C = (None if keys[name] is None else np.array(keys[name], float) for name in names)
    assert T is not None, "every hypothesis has a pose"
    pose = RefinedPose(T, keys["contact_iou"], keys["converged"], keys["iterations"], covariance)
    if T_base_sensor is None or T_base_object is None:
        return pose
    T_sensor_base = invert(T_base_sensor)
    reported = None if C is None else rotate_covariance(C, T_sensor_base[:3, :3])
    return dataclasses.replace(pose, T_reported_object=T_sensor_base @ T_base_object, reported_covariance=reported)


def read_refined_by(document: Any) -> RefinedBy | None:
    """Return what refined the poses, if the file states it. Raises ValueError."""
    return None if document is None else RefinedBy(**read_keys(REFINED_BY, document, "refined_by"))


def read_pose_set(document: Any) -> PoseSet | None:
    """Return the set that the hypotheses are, if there is one. Raises ValueError."""
    return None if document is None else PoseSet(**read_keys(POSE_SET, document, "pose_set"))


def read_assessment(document: dict[str, Any], kept_probability: float) -> Assessment:
    """Return what a result's document says about the first pose. `kept_probability` is that of the poses in the file.

    Raises ValueError.
    """
    freedom, errors = read_keys(FREEDOM, document["freedom"], "freedom"), None
    if document["errors"] is not None:
        closest_m = read_keys(ERRORS, document["errors"], "errors")["closest_in_grid_m"]
        errors = PoseErrors(tuple(one["error_m"] for one in document["hypotheses"]), closest_m)
    return Assessment(
        Verdict(document["verdict"]),
        read_outcome(document),
        Freedom(
            freedom["others"],
            np.array(freedom["slide_m"]),
            np.array(freedom["turn_rad"]),
            np.array(freedom["other_turn_rad"]),
            np.array(freedom["other_shift_m"]),
            freedom["contact_std_m"],
        ),
        document["next_step"],
        document["grid_poses"],
        document["entropy_nats"],
        kept_probability,
        errors,
        tuple(document["poor_touches"]),
        document["error_quantile_m"],
    )


def read_outcome(document: dict[str, Any]) -> Outcome | None:
    """Return the outcome in a result's document; None if it is unknown."""
    right, missed = document["probability_within"], document["missed"]
    return None if right is None else Outcome(right, max(0.0, 1 - right - missed), missed)
