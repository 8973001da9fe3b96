"""Several touches at once: each localised for itself, then fused, and refined against all of them.

The sensors may be of different kinds; each touch says where its sensor was. The answer is in the first one's frame.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tactile_loc.core.errors import TouchError
from tactile_loc.core.geometry import invert
from tactile_loc.core.interfaces import Candidate, Prior, RefinedPose
from tactile_loc.core.poses import Poses
from tactile_loc.core.posterior import Mode
from tactile_loc.core.progress import timed
from tactile_loc.core.sensing import Touch
from tactile_loc.locate.result import Hypothesis, Localization, distinct

if TYPE_CHECKING:
    from tactile_loc.locate.localizer import Localizer

Contact = tuple["Localizer", Touch]


def localize_together(contacts: Sequence[Contact], prior: Prior | None = None, top: int | None = None) -> Localization:
    """Return the distribution over poses given several touches of one object, and its distinct hypotheses, refined.

    Each touch comes with the localizer of its object and its sensor, and knows `T_base_sensor` (4, 4), metres. The
    posterior is over the first localizer's grid; `prior` maps its poses (N, 4, 4) to log-weights (N,). `explained` is
    the mean over the touches. Raises TactileLocError when nothing fits all of them.
    """
    _require_one_object(contacts)
    first, touch = contacts[0]
    seconds: dict[str, float] = {}
    posteriors = timed(seconds, "touches", lambda: [localizer.single_posterior(t) for localizer, t in contacts])
    T_base_sensor = [t.T_base_sensor for _, t in contacts]
    fused = timed(seconds, "fuse", lambda: first.fuser.fuse(posteriors, T_base_sensor, prior))
    most = top or first.config.top
    hypotheses = timed(seconds, "refine", lambda: _refined(contacts, fused.modes(first.mode_radius_m, most)))
    found = distinct(hypotheses, first.model.grid.metric, first.same_pose_m, prior)
    return Localization(touch, fused, found, seconds, tuple(t for _, t in contacts[1:]))


def _require_one_object(contacts: Sequence[Contact]) -> None:
    if not contacts:
        raise TouchError("there is no touch to localise; give one at least")
    objects = {localizer.object.mesh.digest for localizer, _ in contacts}
    if len(objects) > 1:
        names = ", ".join(dict.fromkeys(localizer.object.name for localizer, _ in contacts))
        raise TouchError(f"the touches are of several objects ({names}); locate each by its own touches")


def _refined(contacts: Sequence[Contact], modes: Sequence[Mode]) -> list[Hypothesis]:
    """A hypothesis for each mode: of its pose and what refinement against each touch makes of it, the one that all
    touches together like best."""
    peaks = np.stack([mode.T_sensor_object for mode in modes])
    tried = [[RefinedPose(T, 0.0, False, 0) for T in peaks]]
    for localizer, touch in contacts:
        to_sensor = _to_sensor(contacts[0][1], touch)
        candidates = [Candidate(to_sensor @ m.T_sensor_object, m.index, float(np.log(m.probability))) for m in modes]
        found = localizer.refiner.refine_many(touch, candidates, localizer.scene)
        back = invert(to_sensor)
        tried.append([dataclasses.replace(r, T_sensor_object=back @ r.T_sensor_object) for r in found])
    liked = np.stack([_explained(contacts, np.stack([r.T_sensor_object for r in row])) for row in tried])
    best = liked.argmax(axis=0)
    return [
        Hypothesis(m.probability, m.T_sensor_object, tried[b][k], m.index, len(m.members), float(liked[b, k]))
        for k, (m, b) in enumerate(zip(modes, best, strict=True))
    ]


def _explained(contacts: Sequence[Contact], T_first_object: Poses) -> np.ndarray:
    """How well poses (K, 4, 4) in the first sensor's frame explain all touches: mean (K,), 0 to 1, unitless."""
    first = contacts[0][1]
    return np.mean([c.scene.explained(_to_sensor(first, t) @ T_first_object, t) for c, t in contacts], axis=0)


def _to_sensor(first: Touch, touch: Touch) -> Poses:
    """`T_sensor_first` (4, 4), metres, from the first touch's sensor frame to this touch's."""
    if touch is first:
        return np.eye(4)
    T: Poses = invert(np.asarray(touch.T_base_sensor)) @ np.asarray(first.T_base_sensor)
    return T
