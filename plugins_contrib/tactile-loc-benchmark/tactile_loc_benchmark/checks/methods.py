"""Checks for methods of a benchmark: rigid poses in the base frame, sound scores, and no changes to the touches."""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tactile_loc.plugin import Scene, TactileLocError, Touch, registry
from tactile_loc.plugin.helpers import PoseMetric, invert, is_rigid, make_transform, rotation_about
from tactile_loc.testing.contract import ContractError, Untouched, check, require
from tactile_loc.testing.problems import ReferenceRenderer, make_block, make_planar_pose, make_touch, replace_depth

from tactile_loc_benchmark.interfaces import LocatingProblem, Method, ScoredPoses

SENSOR = "gelsight-mini"
T_BASE_OBJECT = make_transform(rotation_about([1.0, -2.0, 0.5], 2.1), [0.2, -0.1, 0.05])
OTHER_BASE = make_transform(rotation_about([0.3, 1.0, -2.0], 1.3), [-0.1, 0.2, 0.1])  # maps the base frame to another
TILTS = ((0.0, [1, 0, 0]), (2.2, [1, 1, 0]), (1.3, [1, -3, 0]))  # of the touches: radians, and the axis
PRESS_M = 8e-4
SCATTER_M = 2e-3  # allowed difference of the best poses for two base frames; rounding can change random choices
RANDOM_SCATTER_M = (
    4e-2  # the same for a method that is not deterministic: wrong poses of the block, but the right frame
)
COUNTS = (1, len(TILTS))


@check("method")
def check_answers(method: Method) -> None:
    """`locate` returns rigid poses, the best first, and possible probabilities, for one touch and for several."""
    for answer in _list_answers(method):
        require(isinstance(answer, ScoredPoses), f"locate must return ScoredPoses, not {type(answer).__name__}")
        require(is_rigid(np.asarray(answer.T_base_object)), "every pose must be a rigid transform (4, 4)")
        falling = (np.diff(answer.scores) <= 0).all()
        require(falling, f"poses must be in the order of their scores, the best first, not {answer.scores.tolist()}")
        p = np.zeros(1) if answer.probabilities is None else np.asarray(answer.probabilities)
        require(p.min() >= 0, f"probabilities must not be negative, but one is {p.min():.3g}")
        require(p.sum() <= 1 + 1e-6, f"the sum of all probabilities must be at most 1, not {p.sum():.3g}")


@check("method")
def check_inputs_untouched(method: Method) -> None:
    """The touches and the object are not changed, and the poses have their own memory."""
    method, problem = _prepare(method)
    touches = _make_touches()
    mesh = problem.object.mesh
    before = [Untouched(vertices_m=mesh.vertices_m, faces=mesh.faces)]
    before += [Untouched(depth_m=t.contact_shape.depth_m, T_base_sensor=np.asarray(t.T_base_sensor)) for t in touches]
    answer = _locate(method, problem, touches)
    for untouched in before:
        untouched.require()
    poses = np.empty(0) if answer is None else answer.T_base_object
    shared = any(np.shares_memory(poses, np.asarray(touch.T_base_sensor)) for touch in touches)
    require(not shared, "the poses must not share memory with a touch's T_base_sensor; return a copy")


@check("method")
def check_base_frame(method: Method) -> None:
    """In another base frame, the best pose is the same pose in that frame, or another of the listed poses is."""
    method, problem = _prepare(method)
    touches = _make_touches()
    moved = [dataclasses.replace(t, T_base_sensor=OTHER_BASE @ np.asarray(t.T_base_sensor)) for t in touches]
    plain, other = (_locate(method, problem, some) for some in (touches, moved))
    require((plain is None) == (other is None), "a pose is found in one base frame only; the frame must not matter")
    if plain is None or other is None:
        return
    expected = np.broadcast_to(OTHER_BASE @ plain.T_base_object[0], other.T_base_object.shape)
    off_m = float(PoseMetric(problem.object).symmetric_distance(other.T_base_object, expected).min())
    require(
        off_m <= (SCATTER_M if method.capabilities.deterministic else RANDOM_SCATTER_M),
        f"if all T_base_sensor move, the poses must move with them, but the nearest is {1e3 * off_m:.3g} mm off; "
        "return T_base_object",
    )


@check("method")
def check_nearly_empty_contact(method: Method) -> None:
    """A contact of a few pixels gives an answer or a TactileLocError, never another exception."""
    method, problem = _prepare(method)
    touch = _make_touches()[0]
    for pixels in ([(120, 160)], [(120, 160), (120, 161)], [(20, 30), (200, 300), (60, 13)]):
        depth_m = np.full(touch.geometry.shape, touch.press_depth_m, np.float32)
        depth_m[tuple(np.transpose(pixels))] = 0
        try:
            _locate(method, problem, [replace_depth(touch, depth_m)])
        except Exception as error:
            what = f"{type(error).__name__}: {error}"
            raise ContractError(
                f"a contact of {len(pixels)} pixels must give poses or a TactileLocError: {what}"
            ) from error


@check("method", "deterministic")
def check_same_again(method: Method) -> None:
    """The same touches give the same answer again."""
    method, problem = _prepare(method)
    first, again = (_locate(method, problem, _make_touches()) for _ in range(2))
    same = first is again is None or (
        first is not None
        and again is not None
        and np.array_equal(first.T_base_object, again.T_base_object)
        and np.array_equal(first.scores, again.scores)
    )
    require(same, "the same touches must give the same answer; otherwise declare deterministic=False")


@lru_cache(maxsize=16)
def _prepare(method: Method) -> tuple[Method, LocatingProblem]:
    """Prepare a method for the block, once for all checks. The folder is removed at the end of the process."""
    folder = Path(_FOLDER.name) / str(id(method)) / "methods"
    folder.mkdir(parents=True)
    geometry = registry().create("sensor", SENSOR).geometry
    problem = LocatingProblem(make_block(), {"name": SENSOR}, geometry, folder)
    method.prepare(problem)
    return method, problem


_FOLDER = TemporaryDirectory()


@lru_cache(maxsize=1)
def _make_touches() -> tuple[Touch, ...]:
    """Return touches of the block's features, of an edge and of a corner, in the base frame."""
    scene = Scene(make_block(), registry().create("sensor", SENSOR).geometry, ReferenceRenderer())
    found = []
    for k, (tilt_rad, axis) in enumerate(TILTS):
        tilt = make_transform(rotation_about(axis, tilt_rad), np.zeros(3))
        touch = make_touch(scene, make_planar_pose(1e-3, -1e-3, 0.4) @ tilt, PRESS_M)
        T_base_sensor = T_BASE_OBJECT @ invert(np.asarray(touch.T_sensor_object))
        found.append(dataclasses.replace(touch, name=f"touch-{k}", T_base_sensor=T_base_sensor, T_sensor_object=None))
    return tuple(found)


def _list_answers(method: Method) -> list[ScoredPoses]:
    """Return the method's answers to one touch and to several. At least one of them must be an answer."""
    method, problem = _prepare(method)
    answers = [_locate(method, problem, _make_touches()[:n]) for n in COUNTS]
    found = [answer for answer in answers if answer is not None]
    require(found, "clean touches of a block must give at least one pose, not only errors")
    return found


def _locate(method: Method, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses | None:
    """Return the answer of a method; None if it finds no pose."""
    try:
        return method.locate(problem, touches)
    except TactileLocError:
        return None
