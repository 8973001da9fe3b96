"""Checks for grids: poses must be rigid, have the requested spacing, and cover the poses drawn at random."""

import dataclasses
from functools import partial

import numpy as np

from tactile_loc.core.geometry.rigid import Poses, invert, is_rigid, make_transform, make_translation
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.places.places import CAMERA as PATCH_CAMERA
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric, measure_distances
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.contact import bring_to_contact
from tactile_loc.core.sensing.touch import compute_contact_depth
from tactile_loc.slots.grid import GridSampler
from tactile_loc.testing.contract import (
    Untouched,
    check,
    name_cause,
    require,
    require_array,
    require_close,
    require_equal,
)
from tactile_loc.testing.problems import (
    CAMERAS,
    ReferenceRenderer,
    copy_mesh,
    make_block,
    make_plain_object,
    make_prism,
    make_rod,
    scale_sensor,
    transform_mesh,
)
from tactile_loc.testing.properties import hold, one_of, shifts, whole

CAMERA = CAMERAS["orthographic"]
SPACING_M = 0.008
DRAWN, SIGMAS = 6000, 4  # number of random poses, and the allowed error of their share, in standard errors
PRESS_M, ROUNDED_M, LEAST_ALIKE = 1e-3, 2e-5, 0.97  # of patches: press depth, rounding, least share of equal pixels
NEAR_M, MOST_TILT_DEG = 2.5e-3, 8.0  # limits between the first point of contact and the nearest place
FAR_M = 1.0  # translations this long are no poses of parts of some centimetres
SAME_M = 1e-8  # poses that are nearer than this differ only by rounding
SUBGROUPS = ("z6*x2", "z6", "z3", "x2", "z2")  # subgroups of the prism's rotations
LEAST_APART = 0.15  # spacings; poses that are nearer than this, up to symmetry, must coincide
LEAST_PLACES, MOST_PLACES = 0.75, 2.0  # times the expected number; directions on a border are kept twice
LEAST_TOUCHING = 0.3  # least share of the poses; bounding boxes overlap more often than objects touch


@check("grid")
def check_poses_are_rigid(sampler: GridSampler) -> None:
    """`sample` and `random` return (N, 4, 4) float64 transforms with proper rotations and finite metres."""
    for what, poses in _list_kinds(sampler, 20):
        require(len(poses) > 0, f"{what} must return poses for an object of the sensor's size")
        require_array(poses, (len(poses), 4, 4), np.float64, f"the poses of {what}")
        require(is_rigid(poses), f"the poses of {what} must be rigid: proper rotations, finite, last row 0 0 0 1")
    require(len(_draw_random(sampler, 20)) == 20, "random must return the requested number of poses")


@check("grid", "not places")
def check_spacing(sampler: GridSampler) -> None:
    """Neighbouring poses of the sample, brought to contact, have about the requested distance.

    Core corrects the difference.
    """
    spacing_m = float(_bring_to_contact(_sample(sampler)).neighbour_spacing().mean())
    right = 0.4 * SPACING_M <= spacing_m <= 2 * SPACING_M
    sentence = f"the mean spacing must be about {SPACING_M * 1e3:g} mm, not {spacing_m * 1e3:.2g} mm"
    require(right, sentence, name_cause({"poses are listed twice": spacing_m < SAME_M}))


@check("grid", "not places")
def check_denser_grid_has_more_poses(sampler: GridSampler) -> None:
    """Half the spacing gives at least twice as many poses, even along a line."""
    coarse, fine = (len(_sample(sampler, k * SPACING_M)) for k in (1.0, 0.5))
    sentence = f"half the spacing must give at least twice the {coarse} poses, not {fine}"
    require(fine >= 2 * coarse, sentence, name_cause({"spacing_m is not used": 1 < coarse == fine}))


@check("grid")
def check_poses_reach_contact(sampler: GridSampler) -> None:
    """Enough of the poses touch the sensing rectangle after a move along z only."""
    for what, poses in _list_kinds(sampler, 200):
        share = _count_touching(poses, make_block())
        sentence = f"only {100 * share:.0f} % of the poses of {what} can touch the sensor"
        require(share >= LEAST_TOUCHING, sentence, partial(_name_mistake, poses, make_block()))


@check("grid", "not places")
def check_covers_random_poses(sampler: GridSampler) -> None:
    """The grid covers the poses that `random` draws: each drawn pose is near a grid pose."""
    grid = _bring_to_contact(_sample(sampler))
    drawn = _bring_to_contact(_draw_random(sampler, 200)).T_sensor_object
    spacings = np.quantile(grid.nearest(drawn)[0], [0.5, 0.95]) / SPACING_M
    covered = spacings[0] <= 1.0 and spacings[1] <= 2.0
    require(
        covered,
        "sample must cover the poses that random draws; the nearest grid pose is "
        f"{spacings[0]:.2g} spacings away in the median, and {spacings[1]:.2g} for one in twenty",
    )


@check("grid", "not places")
def check_random_is_uniform_over_the_grid(sampler: GridSampler) -> None:
    """`random` draws a rod's poses uniformly: for yaws at which the rod is wide, it draws the grid's share of poses."""
    obj = make_rod()
    grid = _bring_to_contact(sampler.sample(obj, CAMERA, SPACING_M), obj)
    drawn = _bring_to_contact(sampler.random(obj, CAMERA, DRAWN, np.random.default_rng(0)), obj).T_sensor_object
    rotated = obj.mesh.vertices_m @ np.swapaxes(grid.T_sensor_object[:, :3, :3], -1, -2)
    spanned = np.ptp(rotated[..., :2], axis=1).sum(axis=-1)
    half = spanned > np.median(spanned)
    wanted, found = float(half.mean()), float(half[grid.nearest(drawn)[1]].mean())
    error = float(np.sqrt(wanted * (1 - wanted) / len(drawn)))
    require(
        abs(found - wanted) <= SIGMAS * error,
        "random must draw poses uniformly over the grid; "
        f"{100 * found:.0f} % are nearest to {100 * wanted:.0f} % of its poses",
        lambda: (
            "; often, sample leaves out poses that random draws, or random draws a rotation not in proportion to "
            "its places over the sensor, as draw_places of tactile_loc.plugin.helpers does"
        ),
    )


@check("grid")
def check_random_draws(sampler: GridSampler) -> None:
    """A generator with the same seed draws the same poses. They differ from each other, and from those of another."""
    poses = _draw_random(sampler, 20)
    require(np.array_equal(poses, _draw_random(sampler, 20)), "random must draw from the given generator only")
    distances = PoseMetric(make_block()).distance(poses[:, None], poses[None]) + np.eye(20)
    require((distances > 0).all(), "random must draw different poses, from a continuous set")
    same = np.array_equal(poses, _draw_random(sampler, 20, seed=1))
    require(not same, "random must draw other poses for another seed")


@check("grid")
def check_object_untouched(sampler: GridSampler) -> None:
    """The object's mesh is not changed."""
    obj = _copy_block()
    mesh = obj.mesh
    before = Untouched(vertices_m=mesh.vertices_m, faces=mesh.faces)
    if sampler.capabilities.places:
        sampler.places(obj, Progress())
    else:
        sampler.sample(obj, CAMERA, SPACING_M)
    sampler.random(obj, CAMERA, 5, np.random.default_rng(0))
    before.require()


@check("grid", "not places")
def check_scale(sampler: GridSampler) -> None:
    """If object, sensor and spacing are scaled, the number of poses stays the same, to 5 %: no length is built in."""
    small = _sample(sampler)
    for scale in (0.5, 2.0, 3.0):
        large = sampler.sample(make_block(scale), scale_sensor(CAMERA, scale), scale * SPACING_M)
        alike = abs(len(large) / len(small) - 1) <= 0.05
        require(alike, f"the number of poses must not depend on scale; it is {len(large)} instead of {len(small)}")


@check("grid", "not places", "deterministic")
def check_deterministic(sampler: GridSampler) -> None:
    """The same object, sensor and spacing give the same poses in the same order."""
    first, again = (sampler.sample(_copy_block(), CAMERA, SPACING_M) for _ in range(2))
    require_equal(first, again, "the same request must give the same poses")


@check("grid", "places")
def check_places_are_as_drawn(sampler: GridSampler) -> None:
    """A place's patch is a parallel projection of the object around the place, in the frame of the place."""
    places = sampler.places(make_block(), Progress())
    require(is_rigid(places.T_place_object), "the poses of places must be rigid: proper rotations, finite")
    some = np.linspace(0, len(places) - 1, 12).astype(int)
    found = places.depths(PRESS_M)[some]
    lifted = make_translation([0.0, 0.0, PATCH_CAMERA.standoff_m]) @ places.T_place_object[some]
    drawn = compute_contact_depth(
        ReferenceRenderer().render(make_block().mesh, lifted, PATCH_CAMERA), PATCH_CAMERA, PRESS_M
    )
    off_m = np.abs(found - drawn)
    alike = float((off_m < ROUNDED_M).mean())
    require(alike > LEAST_ALIKE, f"only {100 * alike:.0f} % of the pixels of patches have the depth of the object")
    middle = PATCH_CAMERA.height_px // 2
    require(off_m[:, middle, middle].max() < ROUNDED_M, "a place must have the depth of its patch's middle")


@check("grid", "places")
def check_places_are_in_random_poses(sampler: GridSampler) -> None:
    """The first point of contact of a drawn pose is near a place that is seen from nearly the same direction."""
    obj = make_block()
    places = sampler.places(obj, Progress()).T_place_object
    where, along = -np.einsum("nji,nj->ni", places[:, :3, :3], places[:, :3, 3]), places[:, 2, :3]
    T = _bring_to_contact(_draw_random(sampler, 60)).T_sensor_object
    corners = obj.mesh.vertices_m @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]
    lowest = obj.mesh.vertices_m[corners[..., 2].argmin(axis=1)]
    near = np.linalg.norm(where - lowest[:, None], axis=-1) < NEAR_M
    tilt_deg = np.degrees(np.arccos(np.clip(T[:, 2, :3] @ along.T, -1, 1)))
    worst_deg = np.quantile(np.where(near, tilt_deg, 180.0).min(axis=1), 0.9)
    require(
        worst_deg < MOST_TILT_DEG,
        f"the first point of contact must be a place; for one pose in ten the places within "
        f"{NEAR_M * 1e3:g} mm of it are seen from directions {worst_deg:.0f} degrees off",
    )


@check("grid", "property", "not places", "deterministic")
def property_object_origin(sampler: GridSampler) -> None:
    """If the mesh is shifted by x in its own frame, its poses in contact are T @ inv(x), to 10 nm.

    The mesh is not rotated, because an axis of the object frame may name the face that touches.
    """
    plain = _bring_to_contact(_sample(sampler)).T_sensor_object

    def claim(shift_mm: tuple[int, int, int]) -> None:
        x = make_translation(1e-3 * np.array(shift_mm))
        other = make_plain_object("shifted block", transform_mesh(make_block().mesh, x))
        found = _bring_to_contact(sampler.sample(other, CAMERA, SPACING_M), other).T_sensor_object @ x
        require_close(found, plain, SAME_M, "poses must not depend on the origin of the object's frame")

    hold(claim, shift_mm=shifts())


@check("grid", "property", "not places")
def property_symmetric_copies(sampler: GridSampler) -> None:
    """Two touching poses of a symmetric part either coincide up to symmetry, or are clearly apart.

    Core drops one of two poses that coincide. Other poses must be at least LEAST_APART of the spacing apart, because
    nearer poses would be searched twice.
    """

    def claim(symmetry: str, spacing_tenths_mm: int) -> None:
        spacing_m, obj = 1e-4 * spacing_tenths_mm, _declare_symmetry(symmetry)
        poses = _bring_to_contact(sampler.sample(obj, CAMERA, spacing_m), obj).T_sensor_object
        orbits = PoseMetric(obj).embed_orbits(poses)
        apart_m = np.min([measure_distances(orbit, orbits[0]) for orbit in orbits], axis=0)
        apart_m[(apart_m < ROUNDED_M) | np.eye(len(poses), dtype=bool)] = np.inf
        require(
            apart_m.min() >= LEAST_APART * spacing_m,
            "symmetric poses must coincide or be left out; "
            f"two are {1e3 * apart_m.min():.2g} mm apart at a spacing of {1e3 * spacing_m:g} mm",
        )

    hold(claim, symmetry=one_of(SUBGROUPS), spacing_tenths_mm=whole(60, 90))


@check("grid", "property", "places", "deterministic")
def property_place_origin(sampler: GridSampler) -> None:
    """If the mesh is shifted by x in its own frame, its places are T @ inv(x), to 10 nm, with the same patches."""
    plain = sampler.places(make_block(), Progress())

    def claim(shift_mm: tuple[int, int, int]) -> None:
        x = make_translation(1e-3 * np.array(shift_mm))
        found = sampler.places(make_plain_object("shifted block", transform_mesh(make_block().mesh, x)), Progress())
        sentence = "places must not depend on the origin of the object's frame"
        require_close(found.T_place_object @ x, plain.T_place_object, SAME_M, sentence)
        require(np.array_equal(found.patches, plain.patches), sentence)

    hold(claim, examples=2, shift_mm=shifts())


@check("grid", "property", "places")
def property_symmetric_places(sampler: GridSampler) -> None:
    """If n rotations are declared, the number of places is divided by n, times LEAST_PLACES to MOST_PLACES."""
    count = len(sampler.places(_declare_symmetry("none"), Progress()))

    def claim(symmetry: str) -> None:
        obj = _declare_symmetry(symmetry)
        wanted, found = count / obj.symmetry.order, len(sampler.places(obj, Progress()))
        right = LEAST_PLACES * wanted <= found <= MOST_PLACES * wanted
        require(right, f"symmetric places must be one place; there are {found} instead of {wanted:.0f}")

    hold(claim, examples=2, symmetry=one_of(SUBGROUPS[:3]))


def _copy_block() -> ObjectModel:
    return dataclasses.replace(make_block(), mesh=copy_mesh(make_block().mesh))


def _count_touching(poses: Poses, obj: ObjectModel) -> float:
    """Return the share of poses of an object that can touch."""
    return float(bring_to_contact(obj.mesh, poses, CAMERA)[1].mean())


def _name_mistake(poses: Poses, obj: ObjectModel) -> str:
    """Name the mistake with which the poses (N, 4, 4) would not touch."""
    mistakes = {
        "translations are in millimetres": make_transform(poses[:, :3, :3], poses[:, :3, 3] / 1e3),
        "poses are inverted; return T_sensor_object": invert(poses),
    }
    if np.linalg.norm(poses[:, :3, 3], axis=1).mean() < FAR_M:
        del mistakes["translations are in millimetres"]
    least = max(LEAST_TOUCHING, 2 * _count_touching(poses, obj))

    return name_cause(mistakes, lambda T: _count_touching(T, obj) >= least)


def _declare_symmetry(symmetry: str) -> ObjectModel:
    """Return the prism with some of its rotations declared as its symmetry."""
    return dataclasses.replace(make_prism(), symmetry=SymmetryGroup.parse(symmetry, make_prism().mesh.centroid_m))


def _list_kinds(sampler: GridSampler, count: int) -> list[tuple[str, Poses]]:
    """Return the poses from `sample`, if the sampler lists poses, and `count` poses from `random`, with these names."""
    listed = [] if sampler.capabilities.places else [("sample", _sample(sampler))]
    return [*listed, ("random", _draw_random(sampler, count))]


def _sample(sampler: GridSampler, spacing_m: float = SPACING_M) -> Poses:
    return sampler.sample(make_block(), CAMERA, spacing_m)


def _draw_random(sampler: GridSampler, count: int, seed: int = 0) -> Poses:
    return sampler.random(make_block(), CAMERA, count, np.random.default_rng(seed))


def _bring_to_contact(poses: Poses, obj: ObjectModel | None = None) -> PoseGrid:
    """Bring poses of an object, by default the block, to contact. Return the poses that touch."""
    obj = make_block() if obj is None else obj
    contact, touching = bring_to_contact(obj.mesh, poses, CAMERA)
    sentence = f"several poses must be able to touch the sensor; {touching.sum()} of {len(poses)} can"
    require(touching.sum() > 1, sentence, partial(_name_mistake, poses, obj))
    return PoseGrid(contact[touching], PoseMetric(obj))
