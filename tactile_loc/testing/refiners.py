"""Checks for refiners: the true pose must stay, offsets must shrink, and frames and scales must not matter."""

import dataclasses
from itertools import product

import numpy as np

from tactile_loc.core.geometry.rigid import invert, is_rigid, make_transform, rotation_about
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.slots.refiner import Refiner
from tactile_loc.testing.contract import ContractError, Untouched, check, require, require_array, require_equal
from tactile_loc.testing.problems import (
    CAMERAS,
    OFFSETS,
    PressedBlock,
    copy_mesh,
    make_mirrored_block,
    make_plain_object,
    make_prism,
    press_block,
    press_prism,
    replace_depth,
    transform_mesh,
)
from tactile_loc.testing.properties import Place, RigidMotion, hold, motions, one_of, slides, whole
from tactile_loc.testing.refined import (
    LEFT_OVER,
    Refined,
    copy_candidate,
    require_kept,
    require_related,
    require_same,
    require_shrunk,
    scale_step,
    take,
)

TURNS = ((0.0, 0.0, 0.09), (0.0, 0.0, -0.09))  # offsets of candidates that are only turned, radians
LEFT_TURN = 1.3  # the error of these may grow to at most this share, because a refiner need not correct rotations
ROUNDING_PX = 0.02  # allowed difference between equal problems, pixels; rounding can change a pixel's contact
KEEPS = 0.8  # least imprint IoU of a candidate at the true pose after refinement
LEAST_CHIRAL = 0.05  # least difference of imprint IoU between a part and its mirror image; 0.09 for the block


@check("refiner")
def check_output(refiner: Refiner) -> None:
    """`refine` returns a RefinedPose: a rigid float64 pose, contact_iou from 0 to 1, a bool and an integer."""
    for problem, offset in product(_list_problems(), OFFSETS):
        _require_sound(_refine(refiner, problem, offset))


@check("refiner")
def check_truth_stays(refiner: Refiner) -> None:
    """A candidate at the true pose stays at this pose."""
    for problem in _list_problems():
        require_kept(Refined.by(refiner, problem, problem.make_candidate()))


@check("refiner")
def check_touch_and_candidate_untouched(refiner: Refiner) -> None:
    """The touch, the candidate and the mesh are not changed, and the result has its own memory."""
    problem = press_block()
    candidate, mesh = problem.make_candidate(OFFSETS[0]), copy_mesh(problem.scene.object.mesh)
    scene = dataclasses.replace(problem.scene, object=dataclasses.replace(problem.scene.object, mesh=mesh))
    before = Untouched(
        T_sensor_object=candidate.T_sensor_object,
        depth_m=problem.touch.contact_shape.depth_m,
        vertices_m=mesh.vertices_m,
        faces=mesh.faces,
    )
    result = take(refiner.refine(problem.touch, candidate, scene))
    before.require()
    shared = np.shares_memory(result.T_sensor_object, candidate.T_sensor_object)
    require(not shared, "the refined pose must not be the candidate's own array; return a copy")


@check("refiner")
def check_quarter_turn(refiner: Refiner) -> None:
    """If the touch and the candidate are rotated on the sensor by a quarter turn, the answer is rotated too."""
    turn = make_transform(rotation_about([0, 0, 1], np.pi / 2), np.zeros(3))
    sentence = "a rotated sensor must give the rotated answer"
    often = (
        "the search stops before it converges, voxels, steps or limits of distances are too large, the outline's "
        "walls are in only one of both clouds, or x and y are scaled differently"
    )
    for problem in _list_problems():
        rotated = replace_depth(problem.touch, np.ascontiguousarray(np.rot90(problem.touch.contact_shape.depth_m, -1)))
        for offset in OFFSETS:
            candidate = problem.make_candidate(offset)
            moved = dataclasses.replace(candidate, T_sensor_object=turn @ candidate.T_sensor_object)
            plain = Refined.by(refiner, problem, candidate)
            other = Refined.by(refiner, dataclasses.replace(problem, touch=rotated), moved)
            require_related(plain, other, lambda T: invert(turn) @ T, sentence, often)


@check("refiner")
def check_scale(refiner: Refiner) -> None:
    """Twice the object on twice the sensor gives twice the translation, because no length is built in."""
    sentence = "the answer must scale with the problem"
    often = (
        "a length is fixed in metres, such as a voxel, a step or a limit of distances; "
        "measure it in touch.geometry.pixel_pitch_m"
    )
    for camera in CAMERAS:
        small, large = press_block(camera), press_block(camera, scale=2.0)
        for x, y, yaw in OFFSETS:
            plain = Refined.by(refiner, small, small.make_candidate((x, y, yaw)))
            other = Refined.by(refiner, large, large.make_candidate((2 * x, 2 * y, yaw)))
            require_related(plain, other, lambda T: scale_step(T, 0.5), sentence, often)


@check("refiner")
def check_object_frame(refiner: Refiner) -> None:
    """If the mesh moves by X in its own frame, candidates T @ inv(X) give the same answer @ X, to TOLERANCE_PX."""
    often = "the object is turned about the origin of its frame, not about a point of the object"

    def claim(motion: RigidMotion, off: Place, camera: str) -> None:
        problem = press_block(camera)
        mesh = transform_mesh(problem.scene.object.mesh, motion.T)
        moved = dataclasses.replace(problem.scene, object=make_plain_object("moved block", mesh))
        candidate = problem.make_candidate(off.slide)
        there = dataclasses.replace(candidate, T_sensor_object=candidate.T_sensor_object @ invert(motion.T))
        plain = Refined.by(refiner, problem, candidate)
        other = Refined.by(refiner, dataclasses.replace(problem, scene=moved), there)
        require_related(plain, other, lambda T: T @ motion.T, "the object's own frame must not matter", often)

    hold(claim, motion=motions(), off=slides(), camera=one_of(list(CAMERAS)))


@check("refiner")
def check_ignores_masked_pixels(refiner: Refiner) -> None:
    """Unobserved pixels change nothing."""
    problem = press_block()
    observed = np.ones(problem.touch.geometry.shape, bool)
    observed[:, :20] = False
    geometry = dataclasses.replace(problem.touch.geometry, observed=observed)
    masked = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, geometry=geometry))
    plain = dataclasses.replace(problem.touch, geometry=geometry)
    garbage = replace_depth(plain, np.where(observed, plain.contact_shape.depth_m, np.float32(1e-4)))
    candidate = masked.make_candidate(OFFSETS[0])
    first, again, other = (
        Refined.by(refiner, dataclasses.replace(masked, touch=touch), candidate) for touch in (plain, plain, garbage)
    )
    sentence = "pixels outside touch.geometry.observed_mask must change nothing"
    require_same(first, again, other.result, sentence, 1e-3)


@check("refiner")
def check_degenerate_contact(refiner: Refiner) -> None:
    """A contact that determines few directions (one to a few pixels, a line, a plane) gives a sound result."""
    problem = press_block()
    rows, columns = np.indices(problem.touch.geometry.shape)
    press_m = np.float32(problem.touch.press_depth_m)
    contacts = {
        "one pixel": (rows == 30) & (columns == 30),
        "two pixels": (rows == 30) & (columns >= 30) & (columns < 32),
        "three scattered pixels": np.isin(rows * 64 + columns, [5 * 64 + 5, 40 * 64 + 50, 60 * 64 + 3]),
        "a short line": (rows == 30) & (columns >= 20) & (columns < 40),
        "one row of pixels": rows == 30,
        "one column of pixels": columns == 30,
        "a diagonal of pixels": rows == columns,
        "half a plane": columns < 32,
        "a plane without one pixel": (rows != 30) | (columns != 30),
        "pixels without neighbours": (rows % 3 == 0) & (columns % 3 == 0),
    }
    for what, contact in contacts.items():
        for deep in (np.float32(0), press_m / 2):
            touch = replace_depth(problem.touch, np.where(contact, deep, press_m))
            flat = dataclasses.replace(problem, touch=touch)
            _require_sound(_survives(refiner, flat, flat.make_candidate(), f"a contact of {what}"))


@check("refiner")
def check_candidate_without_contact(refiner: Refiner) -> None:
    """A candidate far from the sensor gives a sound result, with contact_iou 0 if the pose stays far away.

    A refiner that declares `refines` then gives converged=False.
    """
    problem = press_block()
    result = _survives(refiner, problem, _move_candidate(problem), "a candidate without contact")
    _require_sound(result)
    claims = result.contact_iou > 0 and problem.measure_error_m(result) > 0.1
    require(not claims, f"a pose without contact must have contact_iou 0, not {result.contact_iou:.2g}")
    claims = refiner.capabilities.refines and result.converged and result.contact_iou == 0
    require(not claims, "a result without overlap of the contacts must have converged=False")


@check("refiner")
def check_many_are_one_by_one(refiner: Refiner) -> None:
    """`refine_many` returns the results of `refine` in the candidates' order, or an empty list without candidates."""
    for problem in _list_problems():
        candidates = [problem.make_candidate(offset) for offset in (*OFFSETS, (0.0, 0.0, 0.0))]
        candidates.append(_move_candidate(problem))
        many = refiner.refine_many(problem.touch, [copy_candidate(one) for one in candidates], problem.scene)
        require(len(many) == len(candidates), f"{len(candidates)} candidates must give as many poses, not {len(many)}")
        for candidate, result in zip(candidates, many, strict=True):
            _require_sound(result)
            first, again = (Refined.by(refiner, problem, candidate) for _ in range(2))
            sentence, alone = "refine_many must give the same as refine, in the candidates' order", first.result
            require_same(first, again, result, sentence, ROUNDING_PX)
            same = alone.converged == result.converged and abs(alone.contact_iou - result.contact_iou) < 1e-2
            found, right = (f"{r.contact_iou:.3f}, {r.converged}" for r in (result, alone))
            require(same, f"{sentence}; contact_iou and converged are {found} instead of {right}")
    try:
        none = refiner.refine_many(problem.touch, [], problem.scene)
    except Exception as error:
        raise ContractError(f"no candidates must give an empty list, not {type(error).__name__}: {error}") from error
    require(isinstance(none, list) and not none, f"no candidates must give an empty list, not {none!r}")


@check("refiner", "deterministic")
def check_deterministic(refiner: Refiner) -> None:
    """The same touch and candidate give exactly the same pose."""
    problem = press_block()
    first, again = (_refine(refiner, problem, OFFSETS[1]) for _ in range(2))
    require_equal(first.T_sensor_object, again.T_sensor_object, "the same touch and candidate must give the same pose")


@check("refiner", "refines")
def check_offsets_shrink(refiner: Refiner) -> None:
    """On average, candidates 0.7 to 1 mm from the true pose come nearer to it, at the maximal depth and at 40 % of it.

    A light press shows less of the object. Candidates are cut at the touch's press depth. Candidates that are only
    turned must not go away from the true pose.
    """
    for name, press in (("a full press", 1.0), ("a light press", 0.4)):
        problems = [press_block(camera, press=press) for camera in CAMERAS]
        tried, turned = (
            [Refined.by(refiner, p, p.make_candidate(offset)) for p in problems for offset in offsets]
            for offsets in (OFFSETS, TURNS)
        )
        require_shrunk(tried, LEFT_OVER, f"after {name}, candidates must come nearer to the truth")
        require_shrunk(turned, LEFT_TURN, f"after {name}, candidates that are only turned must not go away")


@check("refiner", "property")
def property_symmetric_copies(refiner: Refiner) -> None:
    """For a part with a symmetry S, the candidate T @ S gives the answer of T, times S, to TOLERANCE_PX."""

    def claim(element: int, off: Place, camera: str) -> None:
        problem, S = press_prism(camera), make_prism().symmetry.list_elements()[element]
        candidate = problem.make_candidate(off.slide)
        copy = dataclasses.replace(candidate, T_sensor_object=candidate.T_sensor_object @ S)
        plain, other = (Refined.by(refiner, problem, one) for one in (candidate, copy))
        often = "a motion is measured along the axes of the object's frame"
        require_related(plain, other, lambda T: T @ invert(S), "symmetric poses must have symmetric answers", often)

    hold(claim, element=whole(1, len(make_prism().symmetry.rotations) - 1), off=slides(), camera=one_of(list(CAMERAS)))


@check("refiner", "property")
def property_mirrored_part(refiner: Refiner) -> None:
    """The part's mirror image, started at any yaw, gets a rigid pose and explains the touch worse than the part does.

    Its imprint IoU is lower by at least LEAST_CHIRAL, because its depths differ even where the contacts overlap.
    """

    def claim(yaw_deg: int, camera: str) -> None:
        problem = press_block(camera)
        other = dataclasses.replace(problem.scene, object=make_mirrored_block())
        answer, image = _refine(refiner, problem), _refine_rotated(refiner, problem, other, np.radians(yaw_deg))
        _require_sound(image)
        right, wrong = (
            float(scene.imprint_ious(found.T_sensor_object[None], problem.touch)[0])
            for scene, found in ((problem.scene, answer), (other, image))
        )
        sentence = "a candidate at the true pose must explain its touch after refinement"
        require(right >= KEEPS, f"{sentence}; its imprint IoU is {right:.2f}")
        require(
            right - wrong >= LEAST_CHIRAL,
            "a part must explain its touch better than its mirror image does; "
            f"imprint IoUs are {right:.2f} and {wrong:.2f}",
        )

    hold(claim, yaw_deg=whole(0, 359), camera=one_of(list(CAMERAS)))


def _refine_rotated(refiner: Refiner, problem: PressedBlock, scene: Scene, yaw_rad: float) -> RefinedPose:
    """Refine the scene's object from the true pose, after a rotation by a yaw about its centroid."""
    R = problem.truth[:3, :3] @ rotation_about([0, 0, 1], yaw_rad)
    centroid_m = problem.truth[:3, :3] @ problem.scene.object.mesh.centroid_m + problem.truth[:3, 3]
    start = make_transform(R, centroid_m - R @ scene.object.mesh.centroid_m)
    return take(refiner.refine(problem.touch, Candidate(scene.bring_to_contact(start[None])[0][0], 0, 0.0), scene))


def _list_problems() -> list[PressedBlock]:
    return [press_block(camera) for camera in CAMERAS]


def _move_candidate(problem: PressedBlock) -> Candidate:
    """Return a candidate that is 0.2 m beside the sensor along x and along y."""
    away = problem.truth.copy()
    away[:2, 3] += 0.2
    return Candidate(away, 0, 0.0)


def _refine(refiner: Refiner, problem: PressedBlock, offset: tuple[float, float, float] = (0, 0, 0)) -> RefinedPose:
    return Refined.by(refiner, problem, problem.make_candidate(offset)).result


def _survives(refiner: Refiner, problem: PressedBlock, candidate: Candidate, what: str) -> RefinedPose:
    """Return the result for a difficult case. An error that also occurs in an easy case is raised as it is."""
    try:
        return refiner.refine(problem.touch, candidate, problem.scene)
    except Exception as error:
        _refine(refiner, press_block())
        raise ContractError(f"{what} must give converged=False, not {type(error).__name__}: {error}") from error


def _require_sound(result: RefinedPose) -> None:
    require_array(take(result).T_sensor_object, (4, 4), np.float64, "the refined pose")
    rigid = is_rigid(result.T_sensor_object)
    require(rigid, "the refined pose must be rigid: a proper rotation, finite, last row 0 0 0 1")
    number = isinstance(result.contact_iou, float)
    require(number, f"contact_iou must be a float, not {result.contact_iou!r}; return float(contact_iou)")
    require(0.0 <= result.contact_iou <= 1.0, f"contact_iou must be a share from 0 to 1, not {result.contact_iou:.4g}")
    require(isinstance(result.converged, bool | np.bool_), f"converged must be a bool, not {result.converged!r}")
    counted = isinstance(result.iterations, int | np.integer) and result.iterations >= 0
    require(counted, f"iterations must be a whole number, not {result.iterations!r}")
