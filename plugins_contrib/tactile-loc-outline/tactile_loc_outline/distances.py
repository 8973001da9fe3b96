"""Signed distance to the outline of a mask."""

import numpy as np
from numpy.typing import NDArray


def signed_distances(masks: NDArray[np.bool_], pitch_m: float, reach_m: float) -> NDArray[np.float32]:
    """Return the distances (N, H, W), metres, of pixels from the outlines of masks (N, H, W), at most `reach_m`.

    Pixels are `pitch_m` metres wide. Distances are positive inside and negative outside. An outline follows the edges
    between pixels, and does not include the image's border. All distances are `reach_m` in a full mask, and -`reach_m`
    in an empty mask.
    """
    found = np.empty(masks.shape, np.float32)
    for distances, mask in zip(found, masks, strict=True):
        distances[...] = _one(mask, pitch_m, reach_m)
    return found


def _one(mask: NDArray[np.bool_], pitch_m: float, reach_m: float) -> NDArray[np.floating]:
    from scipy.ndimage import distance_transform_edt

    if mask.all() or not mask.any():
        return np.where(mask, reach_m, -reach_m)
    # The outline is half a pixel nearer than the centre of the first pixel beyond the outline.
    inside, outside = (distance_transform_edt(side) - 0.5 for side in (mask, ~mask))
    return np.clip(np.where(mask, inside, -outside) * pitch_m, -reach_m, reach_m)
