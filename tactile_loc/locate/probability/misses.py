"""The probability that none of a result's poses is the true pose, predicted from everything that is observed.

The log odds are a linear function of `list_observed`. Its weights were fitted to 650 simulated examples of nine
objects: rigid and elastic gels, without noise, with mild and with strong noise, one to five touches. The weights are
the same for every object, so an object's own simulated examples remain held out for its conformal sets.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.locate.hypotheses import LEAST_UNEXPLAINED
from tactile_loc.locate.result.hypothesis import Hypothesis

WEIGHTS = (0.16, -0.68, 0.34, -2.46, 0.76)  # for 1, and for each value of `list_observed`


def predict_miss(hypotheses: Sequence[Hypothesis], touches: int) -> float:
    """Return the predicted probability, 0 to 1, that no hypothesis is within 1 mm of the true pose."""
    log_odds = WEIGHTS[0] + list_observed(hypotheses, touches) @ np.array(WEIGHTS[1:])
    return float(1 / (1 + np.exp(-log_odds)))


def list_observed(hypotheses: Sequence[Hypothesis], touches: int) -> NDArray[np.float64]:
    """Return what is observed in a result of this number of touches, (4,), unitless.

    The values are -ln of the share of the imprints that the best pose leaves unexplained, the same times the logarithm
    of the number of touches, this logarithm, and the entropy of the hypotheses. The press depths and contact areas did
    not help to predict misses on objects that the weights were not fitted to.
    """
    explained, log_touches = -np.log(1 - hypotheses[0].imprint_iou + LEAST_UNEXPLAINED), np.log(touches)
    p = np.array([h.probability for h in hypotheses])
    p = p[p > 0] / p.sum()
    return np.array([explained, explained * log_touches, log_touches, -(p * np.log(p)).sum()])
