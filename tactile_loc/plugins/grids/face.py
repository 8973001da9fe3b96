"""Poses of an object that is pressed with one face: x, y and yaw, with optional small tilts."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import GridError, GridSampler, ObjectModel, Poses, SensorGeometry, TriangleMesh
from tactile_loc.plugin.helpers import (
    SymmetryGroup,
    align_to_z,
    compute_lattice_shape,
    draw_places,
    find_reachable_translations,
    make_shifted_lattice,
    make_transform,
    require_spacing,
    rotation_about,
)

SIDES = {f"{sign}{axis}": s * np.eye(3)[i] for i, axis in enumerate("xyz") for sign, s in (("+", 1.0), ("-", -1.0))}


class FaceGrid(GridSampler):
    """One face of the object lies on the sensor: a lattice over x, y and yaw, times tilts up to `tilt_deg`.

    The lattice of each yaw has a different shift. Without the shifts, a narrow range of contact, such as that of a
    ledge beside the face, could lie between the same rows at every yaw.
    """

    class Options(GridSampler.Options):
        """`face` is the object's side that touches the sensor. "auto" is the side on which the object rests."""

        face: str = Field(default="auto", description="side that touches: +x, -x, +y, -y, +z, -z, auto")
        tilt_deg: float = Field(
            default=0.0,
            ge=0.0,
            le=45.0,
            description="largest tilt about x and y, degrees; spacing_mm then applies to x, y and yaw only",
        )
        tilt_steps: int = Field(default=3, ge=2, le=15, description="tilts for each axis, evenly from -tilt to +tilt")
        max_poses: int = Field(default=2_000_000, ge=1, description="largest allowed number of poses")

    @property
    def spacing_is_mean(self) -> bool:
        """False if the grid has tilts, because the number and step of tilts do not depend on the spacing."""
        return self.options.tilt_deg == 0.0

    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return the lattice (N, 4, 4) whose steps in x, y and yaw each move the surface by `spacing_m` metres RMS.

        Raises GridError when the spacing is below a micrometre, or when the grid would exceed `max_poses`.
        """
        require_spacing(spacing_m)
        R_face = self._find_face_rotation(obj)
        lever_m = float(np.sqrt(np.diag(R_face @ obj.mesh.covariance_m2 @ R_face.T)[:2].sum()))
        fold = count_turns_alike(obj.symmetry, -R_face[2])
        # A whole number of steps fits into each symmetric rotation, so equivalent poses coincide and can be removed.
        period = 1 if fold == math.inf else max(1, round(2 * np.pi * lever_m / (spacing_m * fold)))
        turns = period if fold == math.inf else period * int(fold)
        poses: list[Poses] = []
        count = 0
        for number in range(turns):
            for R in self._list_rotations(R_face, np.array([number * 2 * np.pi / turns])):
                low, high = find_reachable_translations(obj.mesh.vertices_m @ R.T, geometry.rectangle)
                count += int(compute_lattice_shape(low, high, spacing_m).prod())
                self._refuse_too_many(count, obj, spacing_m)
                t_xy = make_shifted_lattice(low, high, spacing_m, number % period)
                poses.append(make_transform(R, np.column_stack([t_xy, np.zeros(len(t_xy))])))
        return np.concatenate(poses)

    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, uniformly in x, y, yaw and tilt."""
        R_face = self._find_face_rotation(obj)
        limit = np.radians(self.options.tilt_deg)

        def rotations(n: int) -> NDArray[np.float64]:
            return _tilt(R_face, rng.uniform(0, 2 * np.pi, n), *rng.uniform(-limit, limit, (2, n)))

        return draw_places(obj, geometry, count, rng, rotations)

    def _refuse_too_many(self, count: int, obj: ObjectModel, spacing_m: float) -> None:
        if count > self.options.max_poses:
            raise GridError(
                f"the face grid of {obj.name} at a spacing of {spacing_m * 1e3:.3g} mm exceeds the limit of "
                f"{self.options.max_poses:,} poses; choose a larger spacing, or raise max_poses"
            )

    def _list_rotations(self, R_face: NDArray[np.float64], yaw_rad: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        steps = self.options.tilt_steps  # each tilt represents an equal share of the range that `random` draws from
        tilts = np.radians((2 * np.arange(steps) + 1 - steps) / steps * self.options.tilt_deg)
        if self.options.tilt_deg == 0.0:
            tilts = np.zeros(1)
        yaw, about_x, about_y = (a.ravel() for a in np.meshgrid(yaw_rad, tilts, tilts, indexing="ij"))
        return _tilt(R_face, yaw, about_x, about_y)

    def _find_face_rotation(self, obj: ObjectModel) -> NDArray[np.float64]:
        """Return the rotation (3, 3) that points the touching face's normal into the sensor, along -z."""
        face = self.options.face
        if face == "auto":
            normal = find_resting_normal(obj.mesh)
        elif face in SIDES:
            normal = SIDES[face]
        else:
            raise GridError(f"there is no face {face!r}; choose {', '.join(SIDES)} or auto")
        return align_to_z(-normal)


@lru_cache(maxsize=8)  # poses may be drawn a few at a time
def find_resting_normal(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Return the outward normal (3,), unitless, of the side on which a mesh's centroid lies lowest.

    This is the facet of the convex hull whose plane is nearest to the centroid. The object is stable on this facet.
    Among equally near facets, the one whose normal has the greatest x (then y, then z) is chosen.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        planes = ConvexHull(mesh.vertices_m - mesh.centroid_m).equations
    except QhullError as error:
        raise GridError("the object is flat and has no resting face; set `face` to +x, -x, +y, -y, +z or -z") from error
    heights = np.round(-planes[:, 3], 7)
    near = planes[heights <= heights.min() + 1e-6, :3]
    return np.asarray(near[np.lexsort(np.round(near.T[::-1], 6))[-1]])


def count_turns_alike(symmetry: SymmetryGroup, normal: NDArray[np.float64]) -> float:
    """Return the number of rotations about a unit normal (3,), in the object frame, that map the object onto itself.

    The number is inf if the object is rotationally symmetric about the normal.
    """
    axis = symmetry.continuous_axis
    if axis is None:
        return int(np.isclose(symmetry.rotations @ normal, normal, atol=1e-3).all(axis=1).sum())
    along = abs(float(axis @ normal))
    if along > 1 - 1e-6 or symmetry.is_sphere:
        return math.inf
    return 2 if len(symmetry.rotations) > 1 and along < 1e-3 else 1


def _tilt(
    R_face: NDArray[np.float64],
    yaw_rad: NDArray[np.float64],
    about_x_rad: NDArray[np.float64],
    about_y_rad: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return rotations (N, 3, 3): the face rotated by yaw, then tilted about the sensor's x and y, (N,) radians."""
    tilt = rotation_about([1, 0, 0], about_x_rad) @ rotation_about([0, 1, 0], about_y_rad)
    return tilt @ rotation_about([0, 0, 1], yaw_rad) @ R_face
