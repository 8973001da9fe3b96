"""Words for places of a part."""

import numpy as np
from numpy.typing import ArrayLike


def write_place(place_m: ArrayLike) -> str:
    """Return a point (3,), metres, as text in mm."""
    return "({:z.1f}, {:z.1f}, {:z.1f})".format(*(1e3 * np.asarray(place_m)))
