"""Contact grids of a given spacing, and random contact poses, from a sampler's candidate poses."""

import logging
from collections.abc import Callable, Iterator

import numpy as np

from tactile_loc.core.geometry.rigid import Float32, Poses
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric, remove_equivalent
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.sensing.gel_surface import deform_gel, mark_touching
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.slots.grid import GridSampler

log = logging.getLogger(__name__)

CLOSE_ENOUGH = 0.03  # allowed relative error of the spacing
MOST_ROUNDS = 3
BATCH = 256  # largest number of random poses drawn and rendered at once
HARDLY_ANY = 1e-3  # least share of the random poses that must have contact


def make_contact_grid(sampler: GridSampler, scene: Scene) -> PoseGrid:
    """Sample poses and bring them to contact. Drop poses without contact, and poses that are equal by symmetry.

    Contact moves poses along z, so neighbours get farther apart than in the sample. Sampling is therefore repeated with
    a corrected spacing, unless the sampler's options fix some of its steps. Raises GridError if no pose is left.
    """
    wanted_m = sampler.options.spacing_mm * 1e-3
    if not wanted_m > 0:
        raise GridError(f"the grid's spacing is {wanted_m * 1e3:g} mm; give a positive spacing_mm")
    asked_m = wanted_m
    found: list[tuple[float, PoseGrid]] = []
    for _ in range(MOST_ROUNDS if sampler.spacing_is_mean else 1):
        grid = _list_contact_poses(sampler, scene, asked_m)
        spacing_m = float(grid.neighbour_spacing().mean()) if len(grid) > 1 else wanted_m
        log.info("grid: %d poses in contact, mean spacing %.2f mm", len(grid), spacing_m * 1e3)
        found.append((abs(spacing_m / wanted_m - 1), grid))
        if found[-1][0] <= CLOSE_ENOUGH:
            break
        asked_m *= wanted_m / spacing_m
    return min(found, key=lambda f: f[0])[1]  # small grids change in steps, so the last spacing need not be the best


def _list_contact_poses(sampler: GridSampler, scene: Scene, spacing_m: float) -> PoseGrid:
    metric = PoseMetric(scene.object)
    poses, touching = scene.bring_to_contact(sampler.sample(scene.object, scene.geometry, spacing_m))
    poses = poses[touching]
    return PoseGrid(poses[remove_equivalent(poses, metric, 0.25 * spacing_m)], metric)


def mark_contact(contact_depths_m: np.ndarray, scene: Scene, percent: float) -> np.ndarray:
    """Return which contact depths (N, H, W), metres, have at least `percent` of the observed pixels in contact (N,)."""
    observed = scene.geometry.observed_mask
    touched = (contact_depths_m < np.float32(scene.geometry.max_depth_m)) & observed
    return touched.sum(axis=(1, 2)) >= max(1.0, percent / 100 * observed.sum())


def mark_touches(contact_depths_m: Float32, scene: Scene, percent: float) -> np.ndarray:
    """Return which objects (N,) touch at least `percent` of the observed pixels in a press to the maximal depth.

    `contact_depths_m` (N, H, W), metres, are those in a rigid gel. An elastic gel touches objects in a smaller area.
    """
    enough = mark_contact(contact_depths_m, scene, percent)
    geometry = scene.geometry
    if not geometry.gel.is_elastic or not enough.any():
        return enough
    depths, press_m = contact_depths_m[enough], geometry.max_depth_m
    touching = mark_touching(depths, deform_gel(depths, press_m, geometry), press_m)
    enough[enough] = mark_contact(np.where(touching, depths, np.float32(press_m)), scene, percent)
    return enough


def draw_contact_poses(sampler: GridSampler, scene: Scene, count: int, rng: np.random.Generator) -> Poses:
    """Draw contact poses (count, 4, 4), metres, uniformly from the continuous set that the sampler's grid covers.

    Raises GridError if hardly any drawn pose has enough contact.
    """
    found = [poses for poses, _ in draw_contacts(sampler, scene, count, rng)]
    return np.concatenate([np.empty((0, 4, 4)), *found])


def draw_contacts(
    sampler: GridSampler,
    scene: Scene,
    count: int,
    rng: np.random.Generator,
    misplace: Callable[[Poses], Poses] | None = None,
) -> Iterator[tuple[Poses, Float32]]:
    """Draw `count` contact poses like `draw_contact_poses`. Yield batches of poses (K, 4, 4) and depths (K, H, W).

    Contact depths, metres, are rendered at the scene's maximal depth. If `misplace` is given, it returns the real
    poses for the drawn poses. The depths are then those of the real poses, which must have enough contact. Raises
    GridError if hardly any pose has enough contact.
    """
    tried = kept = 0
    while kept < count:
        batch = int(np.clip(2 * (count - kept), 16, BATCH))
        poses, touching = scene.bring_to_contact(sampler.random(scene.object, scene.geometry, batch, rng))
        poses = poses[touching]
        seen = poses
        if misplace is not None:
            seen, touching = scene.bring_to_contact(misplace(poses))
            poses, seen = poses[touching], seen[touching]
        depths = scene.render_contact_depths(seen)
        enough = mark_touches(depths, scene, sampler.options.min_contact_percent)
        poses, depths = poses[enough][: count - kept], depths[enough][: count - kept]
        tried, kept = tried + batch, kept + len(poses)
        yield poses, depths
        if tried > 2 / HARDLY_ANY and kept < HARDLY_ANY * tried:
            raise GridError(
                f"hardly any random pose of {scene.object.name} touches "
                f"{sampler.options.min_contact_percent:g} % of the sensor; lower grid.min_contact_percent or choose "
                "another face"
            )
