"""The evidence for the first pose of a result: numbers that `outcome_model` makes a probability of.

They state how well the first pose explains the touches, how much worse other poses explain them, and how noisy and how
large the touches are. The other poses are the best pose that is not within the tolerance of the first pose, and probes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Poses, invert
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.sensing.scene import IOU_PX, NATS_PER_IOU, View, compute_sensor_error_nats
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import LEAST_UNEXPLAINED, find_seen_poses
from tactile_loc.locate.probability.probes import DIRECTIONS, Probes, place_probes
from tactile_loc.locate.result.hypothesis import Hypothesis

TIE_IOU = 1e-4  # a pose that loses less imprint IoU explains the touches as well, and is as probable
NEAR_GAPS = (0.02, 0.05)  # losses of imprint IoU within which poses are counted
NO_GAP = 6.0  # stated if there is no other pose; -log of the share of an imprint that is left unexplained
NO_STD_M = 0.02  # stated if the covariance is unknown
RESIDUALS = ("unexplained", "missing", "extra", "outline", "press", "relief", "slope", "sensor_nats")
SURFACE = ("area", "indentation", "roughness", "least_roughness", "raggedness", "elastic", "outline_length", "relief")
FEATURES = (
    "touches",
    "imprint_iou",
    *(f"mean_{name}" for name in RESIDUALS),
    *(f"most_{name}" for name in RESIDUALS),
    *(f"touch_{name}" for name in SURFACE),
    *("least_area", "most_area", "most_roughness", "most_raggedness", "mask", "contradictory", "hypotheses", "same"),
    *("gap", "iou_gap", "near", "rather_near", "distance", "largest_gap", *(f"rival_{name}" for name in RESIDUALS)),
    *("probe_gap", "probe_iou_gap", "near_probes", "rather_near_probes", "largest_probe_gap"),
    *(f"probe_{name}" for name in RESIDUALS),
    *(f"std_{k}" for k in range(DIRECTIONS)),
)


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked about the poses of an object: whether the first one is right within a `tolerance`.

    The `prior` is over poses in the first touch's sensor frame. `contradictory` states whether touches contradict.
    """

    object: ObjectModel
    tolerance: Tolerance
    prior: Prior | None = None
    contradictory: bool = False


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a result shows about its first pose: `values` (F,), in the order of FEATURES.

    `near` (K,) marks the hypotheses within the tolerance of the first one, and `ties` is the number of others that
    lose less than TIE_IOU. `fits` (N, 1 + S) are, for each touch, the log of the share that the first pose leaves
    unexplained, and the SURFACE. `press_m` (N,), metres, is how much deeper the touch shows the object than the first
    pose has it. `probes` are those of the first pose, None if its covariance is unknown. `probe_losses` (2 D,) are how
    much imprint IoU they lose.
    """

    values: Floats
    near: Bools
    ties: int
    fits: Floats
    press_m: Floats
    probes: Probes | None
    probe_losses: Floats


def gather_evidence(views: Sequence[View], hypotheses: Sequence[Hypothesis], asked: Question) -> Evidence:
    """Return the evidence for the first of the hypotheses of N touches, the most probable first.

    A pose that the prior makes less probable counts as if it had less imprint IoU: see NATS_PER_IOU.
    """
    obj, tolerance, prior = asked.object, asked.tolerance, asked.prior
    first, T = hypotheses[0], np.stack([h.T_sensor_object for h in hypotheses])
    unlikely = np.maximum(0.0, first.prior_nats - np.array([h.prior_nats for h in hypotheses])) / NATS_PER_IOU
    ious = np.array([h.imprint_iou for h in hypotheses]) - unlikely
    ratios = tolerance.measure_ratios(obj, T[0], T)
    rivals = np.flatnonzero(ratios > 1)
    compared = [first]
    if len(rivals):
        compared.append(hypotheses[int(rivals[ious[rivals].argmax()])])
    seen = find_seen_poses(views, [h.refined for h in compared])
    poses = [h.T_sensor_object for h in compared]
    probes = None if first.covariance is None else place_probes(T[0], first.covariance, obj, tolerance)
    if probes is not None:
        corrected = seen[0] @ invert(np.stack([view.T_sensor_first @ T[0] for view in views]))
        there = [corrected[k] @ view.T_sensor_first @ probes.T for k, view in enumerate(views)]
        seen, poses = np.concatenate([seen, np.stack(there, axis=1)]), [*poses, *probes.T]
    residuals, press_m = _measure_residuals(views, seen, np.stack(poses))
    probed_ious = 1 - np.exp(residuals[len(compared) :, :, 0]).mean(axis=1) + LEAST_UNEXPLAINED
    if probes is not None:
        beyond = tolerance.measure_ratios(obj, T[0], probes.T) > 1
        weights = np.zeros(len(beyond)) if prior is None else first.prior_nats - prior(probes.T)
        probed_ious = np.where(beyond, probed_ious - np.maximum(0.0, weights) / NATS_PER_IOU, -1.0)
    surface = np.stack([describe_surface(view.touch) for view in views])
    one, own = residuals[0], ious[0]
    # The mean imprint IoU as that of the probes: errors of sensor poses cost nothing
    drawn = 1 - float(np.exp(one[:, 0]).mean()) + LEAST_UNEXPLAINED
    values = [
        np.array([len(views), own]),
        *(one.mean(axis=0), one.max(axis=0), surface.mean(axis=0)),
        np.array([surface[:, 0].min(), *surface[:, [0, 2, 4]].max(axis=0)]),
        np.array([not all(v.touch.has_depths for v in views), asked.contradictory, len(T), len(T) - len(rivals)]),
        _compare(own, ious[rivals], one, residuals[1:2] if len(rivals) else None, np.log(1e-3 + ratios[rivals])),
        _compare(drawn, probed_ious, one, None if probes is None else residuals[len(compared) :]),
        np.log(np.full(DIRECTIONS, NO_STD_M) if probes is None else probes.std_m + 1e-6),
    ]
    fits = np.column_stack([one[:, 0], surface])
    equal = int((own - ious[rivals] < TIE_IOU).sum())
    losses = drawn - probed_ious
    return Evidence(np.concatenate(values).astype(float), ratios <= 1, equal, fits, press_m[0], probes, losses)


def _compare(own: float, ious: Floats, one: Floats, others: Floats | None, distances: Floats | None = None) -> Floats:
    """Return how much worse K poses with mean imprint IoUs (K,) explain N touches than the first pose.

    `one` (N, R) are the residuals of the first pose, and `others` (K, N, R) those of the poses, or (1, N, R) of the
    best one. `distances` (K,) are the logarithms of the poses' distances from the first pose, in tolerances.
    """
    if others is None or not len(ious):
        distance = () if distances is None else (0.0,)
        return np.array([NO_GAP, 1.0, 0, 0, *distance, NO_GAP, *np.full(one.shape[1], NO_GAP)])
    best = int(ious.argmax())
    more = (others[best] if len(others) == len(ious) else others[0]) - one
    gap = np.log(1 - min(ious[best], 1.0) + LEAST_UNEXPLAINED) - np.log(1 - min(own, 1.0) + LEAST_UNEXPLAINED)
    distance = () if distances is None else (distances[best],)
    counts = [(own - ious <= near).sum() for near in NEAR_GAPS]
    return np.array([gap, own - ious[best], *counts, *distance, more[:, 0].max(), *more.mean(axis=0)])


def _measure_residuals(views: Sequence[View], seen: Poses, T: Poses) -> tuple[Floats, Floats]:
    """Return the RESIDUALS (K, N, R) of poses T (K, 4, 4) in the first sensor's frame, and the press errors (K, N).

    `seen` (K, N, 4, 4) are the poses in each sensor's frame. All lengths are in metres; the residuals are logarithms.
    """
    found, press_m = [], []
    for number, view in enumerate(views):
        each = view.scene.measure_residuals(seen[:, number], view.touch)
        error = seen[:, number] @ invert(view.T_sensor_first @ T)
        nats = np.minimum(compute_sensor_error_nats(view, views[0], error), 20.0)
        outline_mm, press_mm, relief_mm = (
            np.minimum(1e3 * np.abs(value), 5.0) for value in (each.outline_m, each.press_m, each.relief_m)
        )
        logs = [
            np.log(1 - each.imprint_ious + LEAST_UNEXPLAINED),
            np.log(each.missing + 0.02),
            np.log(np.minimum(each.extra, 5.0) + 0.02),
            np.log(outline_mm + 0.02),
            np.log(press_mm + 0.01),
            np.log(relief_mm + 0.01),
            np.log(each.slope + 0.03),
            nats,
        ]
        found.append(np.column_stack(logs))
        press_m.append(each.press_m)
    return np.stack(found, axis=1), np.stack(press_m, axis=1)


@lru_cache(maxsize=64)
def describe_surface(touch: Touch) -> Floats:
    """Return the SURFACE (S,) of a touch: its size, and the noise that it shows itself. Lengths are logarithms of mm.

    The roughness is the mean second difference of depths between neighbouring pixels in contact, and the least
    roughness its median. The raggedness is the share of the outline that the majority of 3 x 3 pixels would change.
    """
    geometry, shape = touch.thin(IOU_PX)
    contact, pitch_mm = shape.contact & geometry.observed_mask, 1e3 * geometry.pixel_pitch_m
    steps = np.concatenate([_list_bends(shape.depth_m.T, contact.T), _list_bends(shape.depth_m, contact)])
    mean_mm, median_mm = (1e3 * float(f(steps)) if len(steps) else 0.0 for f in (np.mean, np.median))
    padded = np.pad(contact, 1, mode="edge").astype(np.int8)
    down = padded[:-2] + padded[1:-1] + padded[2:]
    smooth = down[:, :-2] + down[:, 1:-1] + down[:, 2:] > 4
    edges = int((contact[1:] != contact[:-1]).sum() + (contact[:, 1:] != contact[:, :-1]).sum())
    relief_mm = 1e3 * float(shape.depth_m[contact].std()) if contact.any() else 0.0
    return np.array(
        [
            np.log(contact.sum() * pitch_mm**2 + 0.05),
            1e3 * touch.indentation_m,
            np.log(mean_mm + 1e-3),
            np.log(median_mm + 1e-3),
            (smooth != contact).sum() / max(edges, 1),
            float(geometry.gel.is_elastic),
            np.log(edges * pitch_mm + 0.5),
            np.log(relief_mm + 0.01),
        ]
    )


def _list_bends(depth_m: Float32, contact: Bools) -> Floats:
    """Return the absolute second differences, metres, of depths along rows, where three neighbours are in contact."""
    inside = contact[:, 2:] & contact[:, 1:-1] & contact[:, :-2]
    return np.abs(depth_m[:, 2:] - 2 * depth_m[:, 1:-1] + depth_m[:, :-2])[inside].astype(float)
