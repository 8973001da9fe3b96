"""Several touches of one object, each with the localizer of its sensor, and the calls that locate them together.

A single touch is located by the same calls.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from tactile_loc.bases.common_poses import require_sensor_poses
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.posterior import NoPoseLeft, PosePosterior, require_pose_left
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.runtime.compiled import use_one_blas_thread
from tactile_loc.core.runtime.errors import ConfigError, TouchError
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.scene import Scene, view_touch
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.method import LocatingMethod, Query, Refinement
from tactile_loc.locate.outliers import localize_agreeing, localize_by_likeliest_law, require_within_reach
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.sources.source import PoseSource
from tactile_loc.slots.fuser import Fuser


class TouchLocalizer(Protocol):
    """The part of a `Localizer` that locating its touches together with others needs."""

    config: RunConfig
    object: ObjectModel
    scene: Scene
    fuser: Fuser
    refinement: Refinement

    @property
    def source(self) -> PoseSource:
        """The source of candidate poses."""

    def require_own(self, touch: Touch) -> None:
        """Raise TouchError unless `touch` is of the localizer's sensor."""


Observation = tuple[TouchLocalizer, Touch]  # a touch, and the localizer of its object and its sensor


@use_one_blas_thread()
def localize_together(
    observations: Sequence[Observation],
    prior: Prior | None = None,
    top: int | None = None,
    coverage: float | None = None,
    starts: Poses | None = None,
    searches: bool = True,
) -> Localization:
    """Return the posterior over poses given touches of one object, and its `top` distinct hypotheses, refined.

    Each touch comes with the localizer of its object and its sensor; sensors may differ. If there are several touches,
    each needs `T_base_sensor` (4, 4), metres. Poses are in the first touch's sensor frame, and the posterior is over
    the first localizer's grid. `prior` maps poses (N, 4, 4) of this grid to log-weights (N,). `coverage` is as for
    `Localizer.localize`. The poses `starts` (K, 4, 4), metres, in the first touch's sensor frame, are refined and
    compared in any case; without `searches`, they are the only ones. If the poses that a prior favours do not fit, the
    touches are also located without it, to see if it is wrong. Raises TactileLocError if no pose fits all touches.

    `Localization.outliers` are the touches that contradict the others. If the first localizer's configuration sets
    `drop_outliers`, the other touches are located again without the outliers. The outliers are then in
    `Localization.left_out`, and poses are in the sensor frame of the first remaining touch.
    """
    query = replace(make_query(observations, prior, top), starts=starts, searches=searches)
    require_within_reach(query.touches, observations[0][0].object)
    query = replace(query, coverage=_choose_coverage(observations, coverage))
    method = make_method([localizer for localizer, _ in observations])
    found = require_pose_left(localize_by_likeliest_law(query, method))
    if query.prior is None or found.verdict in (Verdict.CERTAIN, Verdict.AMBIGUOUS):
        return found
    alone = localize_agreeing(replace(query, prior=None, coverage=None), method)
    return found if isinstance(alone, NoPoseLeft) else found.compare_without_prior(alone)


def compute_posterior_together(
    observations: Sequence[Observation], prior: Prior | None = None, times: StageTimes | None = None
) -> PosePosterior:
    """Return the posterior over the first localizer's grid given touches, as for `localize_together`.

    Adds stage durations to `times`.
    """
    query = make_query(observations, prior, times=times)
    method = make_method([localizer for localizer, _ in observations])
    return require_pose_left(method.fuse(method.search(query), query))


def make_query(
    observations: Sequence[Observation],
    prior: Prior | None = None,
    top: int | None = None,
    times: StageTimes | None = None,
) -> Query:
    """Make a query; if `top` is None, the first localizer's setting is used.

    Raises TactileLocError if `top` is below 1, or if touches cannot be located together.
    """
    _require_one_object(observations)
    (localizer, first), touches = observations[0], [touch for _, touch in observations]
    if len(touches) > 1:
        require_sensor_poses([touch.T_base_sensor for touch in touches])
    top = localizer.config.top if top is None else top
    if top < 1:
        raise ConfigError(f"cannot list {top} hypotheses; set `top` to 1 or more")
    views = [view_touch(first, touch, own.scene.match_touch(touch)) for own, touch in observations]
    return Query(views, prior, top, times=times or StageTimes())


def make_method(localizers: Sequence[TouchLocalizer]) -> LocatingMethod:
    """Return the components that locate touches, one of each localizer."""
    first, sources = localizers[0], [localizer.source for localizer in localizers]
    return LocatingMethod(sources, first.fuser, first.refinement, first.config)


def _choose_coverage(observations: Sequence[Observation], asked: float | None) -> float | None:
    """Return the requested coverage, 0 to 1, or that of the first localizer's settings.

    Raises ConfigError if a coverage cannot be promised.
    """
    probability = observations[0][0].config.coverage if asked is None else asked
    if probability is None:
        return None
    masks = [touch.name for _, touch in observations if not touch.has_depths]
    if masks:
        raise ConfigError(f"no `coverage` can be promised for {masks[0]}, which is a contact mask; leave it out")
    return probability


def _require_one_object(observations: Sequence[Observation]) -> None:
    if not observations:
        raise TouchError("there is no touch to localise; give at least one")
    for localizer, touch in observations:
        localizer.require_own(touch)
    objects = {localizer.object.mesh.digest for localizer, _ in observations}
    if len(objects) > 1:
        names = ", ".join(dict.fromkeys(localizer.object.name for localizer, _ in observations))
        raise TouchError(f"the localizers are of several objects ({names}); locate each object by its own touches")
