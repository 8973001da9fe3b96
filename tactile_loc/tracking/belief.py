"""The belief in a pose that many touches of a slide explain together.

The model of outcomes was fitted to at most five touches from anywhere on the object. It does not know how much more
the tenth touch of a slide tells. So two more facts count: by how much the touches together prefer the first pose to all
other poses found, and how far its covariance lets it be from the true pose.
"""

from dataclasses import replace

import numpy as np

from tactile_loc.core.geometry.lie import move
from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.sensing.scene import NATS_PER_IOU
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Outcome

LEAST_TOUCHES = 3  # fewer touches may agree on a wrong pose by chance
SHARED = 0.5  # share of a touch's nats that counts, because touches of one slide have similar errors
DRAWS = 256  # poses drawn from a covariance


def believe(found: Localization, obj: ObjectModel, tolerance: Tolerance) -> Localization:
    """Return the result of touches of one slide with the outcome that all of them together justify.

    The first pose is right if no other pose found is right, and if its own error is within the tolerance. The
    probability is the product of the two, or that of the model of outcomes if it is greater.
    """
    first, others = found.hypotheses[0], (*found.hypotheses[1:], *found.unlisted)
    trusted = len(found.touches) - len(found.agreement.outliers)
    if found.outcome is None or found.evidence is None or first.covariance is None or trusted < LEAST_TOUCHES:
        return found
    rivals = [one for one, near in zip(others, found.evidence.near[1:], strict=True) if not near]
    losses = np.array([first.imprint_iou - one.imprint_iou for one in rivals])
    unlikely = np.array([min(0.0, first.prior_nats - one.prior_nats) for one in rivals])
    mode = 1 / (1 + float(np.exp(-SHARED * NATS_PER_IOU * trusted * losses - unlikely).sum()))
    within = measure_share_within(first.T_sensor_object, first.covariance, obj, tolerance)
    right = mode * within
    if right <= found.outcome.right:
        return found
    rest = (1 - right) / (1 - found.outcome.right)
    return replace(found, outcome=Outcome(right, rest * found.outcome.another, rest * found.outcome.missed))


def measure_share_within(T: Floats, covariance: Floats, obj: ObjectModel, tolerance: Tolerance) -> float:
    """Return the probability, 0 to 1, that a pose (4, 4), metres, with a covariance (6, 6) is within a tolerance.

    The covariance is as in RefinedPose.
    """
    values, vectors = np.linalg.eigh(covariance)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    moved = move(T, np.random.default_rng(DRAWS).normal(size=(DRAWS, 6)) @ spread.T)
    return float((tolerance.measure_ratios(obj, T, moved) <= 1).mean())
