"""Small features that would remove a confusion: a bump or a dimple, tried at several places of the mesh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tactile_loc import TriangleMesh
from tactile_loc.plugin import ObjectModel, TactileLocError
from tactile_loc.plugin.helpers import SymmetryGroup

from tactile_loc_touchability.rivals import ConfusedPair, choose_marks, tell_apart
from tactile_loc_touchability.study import Study
from tactile_loc_touchability.words import write_place, write_share

RADIUS_M = 1e-3  # of the ball that is added or removed
KINDS = {"dimple": "difference", "bump": "union"}
TRIED = 5  # places at which each kind is tried


class FeatureError(TactileLocError):
    """The mesh cannot be given a feature."""


@dataclass(frozen=True)
class TriedFeature:
    """A feature at a place (3,), metres: the shares of places that tell a pair of poses apart, before and with it."""

    kind: str
    place_m: tuple[float, ...]
    before: float
    after: float

    def describe(self) -> str:
        """Return the feature and its gain in words, as the best one of those tried."""
        if self.after <= self.before:
            told = write_share(self.before)
            return f"no tried feature raises the share of places that tell the poses of pair 1 apart, which is {told}"
        shares = f"from {write_share(self.before)} to {write_share(self.after)}"
        return (
            f"a {self.kind} of {2e3 * RADIUS_M:g} mm diameter at {write_place(self.place_m)} mm raises the share of "
            f"places that tell the poses of pair 1 apart {shares}"
        )


def try_features(study: Study, pair: ConfusedPair) -> list[TriedFeature]:
    """Return features at places where touches confuse a pair of poses, the one with the greatest gain first.

    Raises FeatureError if the mesh is not a closed surface.
    """
    places_m = study.presses.places_m[choose_marks(study.presses.places_m, pair.confused, TRIED)]
    before = float(pair.told.mean())
    tried = [
        TriedFeature(kind, tuple(place.tolist()), before, float(tell_apart(study, pair.motions, changed).mean()))
        for place in places_m
        for kind, changed in change_surface(study.localizer.object, place)
    ]
    return sorted(tried, key=lambda one: -one.after)


def change_surface(obj: ObjectModel, place_m: NDArray[np.float64]) -> Iterator[tuple[str, ObjectModel]]:
    """Yield the kinds of features and the object with each of them at a place (3,), metres. Raises FeatureError."""
    import trimesh

    body = trimesh.Trimesh(obj.mesh.vertices_m, obj.mesh.faces)
    if not body.is_volume:
        raise FeatureError(f"the mesh of {obj.name} is not a closed surface, so no feature was tried on it")
    ball = trimesh.creation.icosphere(2, RADIUS_M).apply_translation(place_m)
    for kind, operation in KINDS.items():
        made = getattr(trimesh.boolean, operation)([body, ball], engine="manifold")
        mesh = TriangleMesh(np.asarray(made.vertices, float), np.asarray(made.faces, np.int64))
        yield kind, ObjectModel(f"{obj.name} with a {kind}", mesh, SymmetryGroup(obj.symmetry.centre_m))
