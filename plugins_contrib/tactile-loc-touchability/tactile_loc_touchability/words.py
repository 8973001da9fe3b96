"""Words for places of a part."""

import numpy as np
from numpy.typing import ArrayLike


def write_place(place_m: ArrayLike) -> str:
    """Return a point (3,), metres, as text in mm."""
    return "({:z.1f}, {:z.1f}, {:z.1f})".format(*(1e3 * np.asarray(place_m)))


def write_share(share: float) -> str:
    """Return a share of a sample, 0 to 1, as text in per cent: 0 %, 7.5 %, 83 %."""
    digits = 1 if 0 < 100 * share < 9.95 else 0
    return f"{100 * share:.{digits}f} %"
