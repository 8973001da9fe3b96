"""The oracle: the grid poses whose clean contact shapes are the nearest to the true ones, pixel by pixel.

It is what a perfect matcher could do, one that noise does not confuse. What it gets wrong, no matcher can tell: poses
that make the same contact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.compiled import in_threads, njit
from tactile_loc.core.errors import TouchError
from tactile_loc.core.sensing import Touch
from tactile_loc.locate.localizer import Localizer

Float32 = NDArray[np.float32]


def oracle_poses(localizer: Localizer, touches: Sequence[Touch]) -> NDArray[np.int64]:
    """Return for each touch the index (T,) of the grid pose whose contact shape is the nearest to the true pose's.

    Both shapes are clean, cut at the touch's press depth and as large as the grid's; the distance is the sum of squared
    differences of depth over the observed pixels. Of shapes as near, the first counts. Raises TouchError for a touch
    whose true pose is not known.
    """
    press = np.array([touch.press_depth_m for touch in touches], np.float32)
    observed = localizer.coarse_scene.geometry.observed_mask
    wanted = np.ascontiguousarray(_true_shapes(localizer, touches)[:, observed])
    best, index = np.full(len(touches), np.inf), np.zeros(len(touches), np.int64)
    start = 0
    for depths in localizer.model.shapes.shards():  # at full press: cut at each touch's own while comparing
        shapes = np.ascontiguousarray(depths[:, observed])
        in_threads(_search, len(wanted), shapes, wanted, press, start, best, index)
        start += len(depths)
    return index


def true_pose(touch: Touch) -> NDArray[np.float64]:
    """Return a touch's true pose (4, 4), metres. Raises TouchError when it is not known."""
    if touch.T_sensor_object is None:
        raise TouchError(f"{touch.name} has no true pose to compare with; simulate it")
    return touch.T_sensor_object


def _true_shapes(localizer: Localizer, touches: Sequence[Touch]) -> Float32:
    """Clean contact depths (T, H, W) of the true poses, metres, each cut at its touch's press depth."""
    scene = localizer.coarse_scene.as_seen()
    shapes = []
    for touch in touches:
        pressed = scene.pressed(touch.indentation_m, touch.press_depth_m)
        shapes.append(pressed.contact_depths(pressed.in_contact(true_pose(touch)[None])[0])[0])
    return np.stack(shapes)


@njit
def _search(first, last, depths, wanted, press, start, best, index):  # type: ignore[no-untyped-def]
    """Look for nearer shapes among depths (S, P) for wanted (T, P); a sum that exceeds the best is not finished."""
    for q in range(first, last):
        for i in range(len(depths)):
            total = 0.0
            for p in range(depths.shape[1]):
                difference = np.float64(min(depths[i, p], press[q])) - np.float64(wanted[q, p])
                total += difference * difference
                if total >= best[q]:
                    break
            if total < best[q]:
                best[q], index[q] = total, start + i
