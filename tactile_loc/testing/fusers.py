"""Checks for fusers: probabilities must multiply over the grid of the first touch; some fusers use only contact."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Poses, invert, make_transform, rotation_about
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import NoPoseLeft, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.runtime.errors import ConfigError, GridError
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.slots.fuser import Fuser
from tactile_loc.testing.contract import (
    ContractError,
    Untouched,
    check,
    name_cause,
    require,
    require_close,
    require_equal,
)
from tactile_loc.testing.problems import (
    CAMERAS,
    ReferenceRenderer,
    make_plain_object,
    make_prism,
    make_small_grid,
    transform_mesh,
)
from tactile_loc.testing.properties import RigidMotion, hold, motions, orders, whole

TOLERANCE = 1e-9  # allowed error of probabilities
T_BASE_FIRST = make_transform(rotation_about([1, 2, 3], 0.4), [0.3, -0.1, 0.2])
T_BASE_SECOND = make_transform(rotation_about([0, 0, 1], 1.1), [0.3, -0.09, 0.21])


@check("fuser")
def check_one_touch(fuser: Fuser) -> None:
    """The posterior of one touch without a prior does not change: it is normalised, over the same grid.

    A fuser that uses only contact makes all poses of the grid equally probable.
    """
    posterior = _draw_posterior(make_small_grid())
    fused = _fuse_one(fuser, posterior)
    require_close(fused.probabilities.sum(), 1.0, TOLERANCE, "probabilities must sum to one")
    if fuser.capabilities.contact_only:
        uniform = np.full(len(posterior.grid), 1 / len(posterior.grid))
        _require_equal(fused, uniform, "with contact_only=True, the poses of one touch must be equally probable")
    else:
        right = posterior.probabilities
        logs = {"probabilities are returned as log_p": _is_over(fused, np.exp(right))}
        _require_equal(fused, right, "one touch without a prior must be unchanged", name_cause(logs))


@check("fuser")
def check_prior_multiplies(fuser: Fuser) -> None:
    """A prior's log-weights are added once, also to several touches. One allowed pose is certain."""
    here = make_small_grid()
    posterior, sensors = _draw_posterior(here), [T_BASE_FIRST, T_BASE_SECOND]
    touches = _draw_posteriors([here, _move_to_second(here)])
    priors: dict[str, Prior] = {
        "a prior with equal weights must change nothing": lambda poses: np.full(len(poses), -3.0),
        "a prior's log-weights must be added once": lambda poses: -((poses[:, 0, 3] / 0.002) ** 2),
        "the only allowed pose must be certain": lambda poses: np.where(np.arange(len(poses)) == 7, 0.0, -np.inf),
    }
    for sentence, prior in priors.items():
        _require_prior(_fuse_one(fuser, posterior), _fuse_one(fuser, posterior, prior), prior, sentence)
        plain, several = (_fuse_several(fuser, touches, sensors, one) for one in (None, prior))
        if plain is not None and several is not None:
            _require_prior(plain, several, prior, f"of two touches, {sentence}")


@check("fuser")
def check_impossible_prior(fuser: Fuser) -> None:
    """A prior that allows no pose leaves none: `fuse` returns `NoPoseLeft`."""
    posterior = _draw_posterior(make_small_grid())
    sentence = "with a prior that allows no pose, fuse must return NoPoseLeft"
    with _no_grid_error(sentence):
        fused = fuser.fuse([posterior], [None], lambda poses: np.full(len(poses), -np.inf))
    require(isinstance(fused, NoPoseLeft), sentence)


@check("fuser")
def check_order(fuser: Fuser) -> None:
    """If touches are reordered, each pose keeps its probability, to TOLERANCE.

    Sensor poses are drawn. All grids hold the same poses in the base frame, so that any touch can be the first.
    """
    grid = make_small_grid()

    def claim(order: list[int], second: RigidMotion, third: RigidMotion) -> None:
        sensors = [np.eye(4), second.T, third.T]
        touches = _draw_posteriors([PoseGrid(invert(T) @ grid.T_sensor_object, grid.metric) for T in sensors])
        plain = _fuse_several(fuser, touches, sensors)
        other = _fuse_several(fuser, [touches[k] for k in order], [sensors[k] for k in order])
        _require_both(other, plain, "the order of touches must not matter")

    hold(claim, order=orders(3), second=motions(), third=motions())


@check("fuser", "not contact_only")
def check_sensor_poses(fuser: Fuser) -> None:
    """Touches are compared in the base frame, so a touch at another sensor pose can resolve an ambiguity."""
    here, there = make_small_grid(), _move_to_second(make_small_grid())
    open_ = PosePosterior(here, np.where(np.isin(np.arange(len(here)), [3, 11]), 0.0, -30.0))
    decides = PosePosterior(there, np.where(np.arange(len(here)) == 11, 0.0, -8.0))
    fused = _fuse_several(fuser, [open_, decides], [T_BASE_FIRST, T_BASE_SECOND])
    if fused is not None:
        p = fused.probabilities
        require(p[11] > 10 * p[3], "touches must be compared by T_base_sensor @ T_sensor_object, pose by pose")


@check("fuser")
def check_no_contact_is_dropped(fuser: Fuser) -> None:
    """A pose that is not near any pose of another sensor's grid has no contact with that sensor and is excluded."""
    here = make_small_grid()
    side = here.T_sensor_object[:, 0, 3] > 0.002
    far = here.metric.distance(here.T_sensor_object[:, None], here.T_sensor_object[side][None]).min(axis=1) > 0.0065
    there = _move_to_second(PoseGrid(here.T_sensor_object[side], here.metric))
    fused = _fuse_several(fuser, [_draw_posterior(here), _draw_posterior(there)], [T_BASE_FIRST, T_BASE_SECOND])
    if fused is not None:
        p = fused.probabilities
        require(bool((p[far] == 0).all()), "poses without contact at a sensor must have probability zero")
        require(bool((p[side] > 0).all()), "poses in every sensor's grid must keep a positive probability")


@check("fuser")
def check_no_common_pose(fuser: Fuser) -> None:
    """Sensors without a common pose leave none: `fuse` returns `NoPoseLeft`. A fuser may refuse several touches."""
    grid = make_small_grid()
    T_base_far = make_transform(np.eye(3), [5.0, 0.0, 0.0])
    sentence = "with sensors metres apart, fuse must return NoPoseLeft"
    try:
        with _no_grid_error(sentence):
            fused = fuser.fuse([_draw_posterior(grid, seed=1), _draw_posterior(grid, seed=2)], [np.eye(4), T_base_far])
    except ConfigError:
        return
    require(isinstance(fused, NoPoseLeft), sentence)


@check("fuser")
def check_base_frame(fuser: Fuser) -> None:
    """If all sensors move together in the base frame, the probabilities stay the same, to TOLERANCE."""
    here, sensors = make_small_grid(), [T_BASE_FIRST, T_BASE_SECOND]
    touches = _draw_posteriors([here, _move_to_second(here)])
    plain = _fuse_several(fuser, touches, sensors)

    def claim(motion: RigidMotion) -> None:
        other = _fuse_several(fuser, touches, [motion.T @ T for T in sensors])
        _require_both(other, plain, "moving the base frame must not matter")

    hold(claim, motion=motions(most_mm=900))


@check("fuser")
def check_posteriors_untouched(fuser: Fuser) -> None:
    """The posteriors and the grids are not changed."""
    posterior = _draw_posterior(make_small_grid())
    before = Untouched(log_p=posterior.log_p, T_sensor_object=posterior.grid.T_sensor_object)
    fuser.fuse([posterior], [np.eye(4)], lambda poses: -poses[:, 0, 3])
    before.require()


@check("fuser", "deterministic")
def check_deterministic(fuser: Fuser) -> None:
    """The same posteriors and prior give the same posterior."""
    prior: Prior = lambda poses: 100 * poses[:, 0, 3]  # noqa: E731
    first, again = (_fuse_one(fuser, _draw_posterior(make_small_grid()), prior) for _ in range(2))
    require_equal(first.log_p, again.log_p, "the same posteriors must give the same answer")


@check("fuser", "property")
def property_object_frame(fuser: Fuser) -> None:
    """An object moved by X in its own frame, with poses T @ inv(X), has the same probabilities, to TOLERANCE."""
    here = make_small_grid()
    sensors, grids = [T_BASE_FIRST, T_BASE_SECOND], [here, _move_to_second(here)]
    plain = _fuse_several(fuser, _draw_posteriors(grids), sensors)

    def claim(motion: RigidMotion) -> None:
        metric = PoseMetric(make_plain_object("moved block", transform_mesh(here.metric.object.mesh, motion.T)))
        moved = [PoseGrid(grid.T_sensor_object @ invert(motion.T), metric) for grid in grids]
        fused = _fuse_several(fuser, _draw_posteriors(moved), sensors)
        _require_both(fused, plain, "the object's own frame must not matter")

    hold(claim, motion=motions())


@check("fuser", "property")
def property_symmetric_copies(fuser: Fuser) -> None:
    """A grid may have any copy T @ S of a pose T, where S is a symmetry of the part.

    All copies in the second touch's grid give the same probabilities, to TOLERANCE.
    """
    grid = make_small_grid(Scene(make_prism(), CAMERAS["orthographic"], ReferenceRenderer()))
    elements, sensors = make_prism().symmetry.list_elements(), [T_BASE_FIRST, T_BASE_SECOND]
    there = _move_to_second(grid)
    plain = _fuse_several(fuser, _draw_posteriors([grid, there]), sensors)

    def claim(seed: int) -> None:
        S = elements[np.random.default_rng(seed).integers(1, len(elements), len(grid))]
        copies = PoseGrid(there.T_sensor_object @ S, grid.metric)
        fused = _fuse_several(fuser, _draw_posteriors([grid, copies]), sensors)
        _require_both(fused, plain, "symmetric poses must count as one")

    hold(claim, seed=whole(0, 999))


def _draw_posteriors(grids: Sequence[PoseGrid]) -> list[PosePosterior]:
    """Return a different posterior over each grid."""
    return [_draw_posterior(grid, seed) for seed, grid in enumerate(grids)]


def _draw_posterior(grid: PoseGrid, seed: int = 0) -> PosePosterior:
    return PosePosterior(grid, np.random.default_rng(seed).normal(scale=2.0, size=len(grid)))


def _move_to_second(grid: PoseGrid) -> PoseGrid:
    """Return the poses of a grid of the first sensor, in the second sensor's frame."""
    return PoseGrid(invert(T_BASE_SECOND) @ T_BASE_FIRST @ grid.T_sensor_object, grid.metric)


def _fuse_several(
    fuser: Fuser, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
) -> PosePosterior | None:
    """Fuse several touches that have common poses. Return None if the fuser refuses several touches."""
    try:
        fused = fuser.fuse(posteriors, T_base_sensor, prior)
    except ConfigError:
        return None
    often = "; often, T_base_sensor is ignored or inverted; a pose of touch k is T_base_sensor[k] @ T_sensor_object"
    require(not isinstance(fused, NoPoseLeft), "touches of one pose must leave poses, not NoPoseLeft", often)
    return _take(cast(PosePosterior, fused), posteriors[0])


def _fuse_one(fuser: Fuser, posterior: PosePosterior, prior: Prior | None = None) -> PosePosterior:
    """Fuse the posterior of one touch with a prior."""
    try:
        fused = fuser.fuse([posterior], [None], prior)
    except Exception as error:
        fuser.fuse(
            [posterior], [np.eye(4)], prior
        )  # an error that does not come from the unknown pose is raised as it is
        problem = f"{type(error).__name__}: {error}"
        raise ContractError(f"the sensor pose of one touch may be unknown: [None] must not raise {problem}") from error
    require(not isinstance(fused, NoPoseLeft), "a possible pose must be left")
    return _take(cast(PosePosterior, fused), posterior)


def _take(fused: PosePosterior, first: PosePosterior) -> PosePosterior:
    """Return a fused posterior. Raises ContractError unless it is a posterior over the first touch's grid."""
    require(isinstance(fused, PosePosterior), f"fuse must return a PosePosterior, not {type(fused).__name__}")
    same = np.array_equal(fused.grid.T_sensor_object, first.grid.T_sensor_object)
    require(same, "the fused posterior must be over the first touch's grid")
    return fused


@contextmanager
def _no_grid_error(sentence: str) -> Iterator[None]:
    try:
        yield
    except GridError as error:
        raise ContractError(f"{sentence}, not raise GridError") from error


def _require_prior(plain: PosePosterior, fused: PosePosterior, prior: Prior, sentence: str) -> None:
    """Raise ContractError unless a prior's log-weights are added once to the plain posterior."""
    weights = prior(plain.grid.T_sensor_object)

    def times(log_weights: Floats) -> Floats:
        p = plain.probabilities * np.exp(log_weights - log_weights.max())
        return np.asarray(p / p.sum())

    wrong = {
        "the prior is ignored": 0 * np.nan_to_num(weights),
        "the prior is added twice": 2 * weights,
        "the prior's log-weights are used as weights": np.exp(weights),
        "the prior is subtracted": -weights,
    }
    mistakes = {what: _is_over(fused, times(logs)) for what, logs in wrong.items() if logs.max() < np.inf}
    _require_equal(fused, times(weights), sentence, name_cause(mistakes))


def _is_over(fused: PosePosterior, weights: NDArray[np.floating]) -> bool:
    """Return whether the probabilities are proportional to the weights."""
    return bool(np.abs(fused.probabilities - weights / weights.sum()).max() <= TOLERANCE)


def _require_both(one: PosePosterior | None, other: PosePosterior | None, sentence: str) -> None:
    """Raise ContractError unless two answers agree, or an answer is None."""
    if one is not None and other is not None:
        _require_equal(one, other.probabilities, sentence)


def _require_equal(fused: PosePosterior, probabilities: NDArray[np.floating], sentence: str, cause: str = "") -> None:
    require_close(fused.probabilities, probabilities, TOLERANCE, f"{sentence} (probabilities)", cause)
