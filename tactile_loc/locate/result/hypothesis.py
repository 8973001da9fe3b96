"""The parts of a result: hypotheses about the object's pose, and the agreement of several touches."""

from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.lie import rotate_covariance
from tactile_loc.core.geometry.rigid import Floats, rotation_to_quaternion_xyzw
from tactile_loc.core.poses.candidate import RefinedPose


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One distinct explanation of the touches.

    `probability` is the probability of the whole mode, which has `grid_poses` poses of the grid. The most probable of
    these poses is `T_sensor_object_grid` (4, 4), metres, with index `grid_index` in the grid. `refined` is the
    refiner's result for this pose. `imprint_iou`, 0 to 1, states how well the refined pose explains the touches in
    depth and outline (`Scene.imprint_ious`). For several touches, `imprint_ious` has one value per touch, and
    `imprint_iou` is the mean of these values without outliers. `prior_nats` is the log-weight of the prior at the
    refined pose, nats; 0 without a prior.

    `T_base_sensor` (4, 4), metres, is the reported pose of the first touch's sensor; None if unknown. If it is known,
    the object's pose in the base frame is known, too.
    """

    probability: float
    T_sensor_object_grid: Floats
    refined: RefinedPose
    grid_index: int
    grid_poses: int
    imprint_iou: float
    imprint_ious: tuple[float, ...] = ()
    T_base_sensor: Floats | None = None
    prior_nats: float = 0.0

    @property
    def T_sensor_object(self) -> Floats:  # noqa: N802 - the field's name
        """The answer: the refined pose (4, 4), metres."""
        return self.refined.T_sensor_object

    @property
    def quaternion_xyzw(self) -> Floats:
        """The rotation of T_sensor_object as a unit quaternion (4,), scalar last, as in ROS."""
        return rotation_to_quaternion_xyzw(self.T_sensor_object[:3, :3])

    @property
    def covariance(self) -> Floats | None:
        """The covariance (6, 6) of the error of T_sensor_object, as in ROS's PoseWithCovariance; None if unknown.

        The order is x, y, z of the object frame's origin (m), then rotations about the sensor's x, y, z axes (rad).
        """
        return self.refined.covariance

    @property
    def T_base_object(self) -> Floats | None:  # noqa: N802 - the transform's name
        """The pose in the base frame (4, 4), metres; None if the sensor's pose is unknown.

        For one touch, this is T_base_sensor @ T_sensor_object. With several touches, the reported poses of all sensors
        count, and each may have an error. T_sensor_object is then relative to the corrected pose of the first sensor,
        and T_base_object may differ from the product by this correction.
        """
        if self.T_base_sensor is None:
            return None
        reported = self.refined.T_reported_object
        return self.T_base_sensor @ (self.T_sensor_object if reported is None else reported)

    @property
    def base_quaternion_xyzw(self) -> Floats | None:
        """The rotation of T_base_object as a unit quaternion (4,), scalar last, as in ROS; None if it is unknown."""
        T = self.T_base_object
        return None if T is None else rotation_to_quaternion_xyzw(T[:3, :3])

    @property
    def base_covariance(self) -> Floats | None:
        """The covariance (6, 6) of the error of T_base_object, as in ROS's PoseWithCovariance; None if unknown.

        The order is x, y, z of the object frame's origin (m), then rotations about the base's x, y, z axes (rad). It
        includes the errors of the sensors' poses, with the standard deviations that the touches state.
        """
        reported = self.refined.reported_covariance
        if self.T_base_sensor is None or reported is None:
            return None
        return rotate_covariance(reported, self.T_base_sensor[:3, :3])

    @property
    def contact_iou(self) -> float:
        """The contact IoU, 0 to 1, from the refiner: see `RefinedPose`."""
        return self.refined.contact_iou

    @property
    def converged(self) -> bool:
        """Whether the refinement converged."""
        return self.refined.converged

    @property
    def iterations(self) -> int:
        """The number of iterations of the refinement."""
        return self.refined.iterations

    @property
    def is_refined(self) -> bool:
        """Whether the refined pose differs from the grid pose; if not, the imprint IoU means little."""
        return not np.array_equal(self.T_sensor_object, self.T_sensor_object_grid)


@dataclass(frozen=True)
class RefinedBy:
    """What refined the poses of a result: names of refiners, or the joint registration; None if nothing did.

    `search` improves the poses in the search of the whole object, `poses` refines the hypotheses, and `covariances`
    gives their covariances. `touches` states how several touches are refined: "together", or "alone" if the results of
    each touch alone are combined by their covariances.
    """

    search: str | None
    poses: str | None
    touches: str | None
    covariances: str | None


@dataclass(frozen=True, eq=False)
class Agreement:
    """Whether N touches agree on a pose. Touches are numbered from 0, in the order given.

    `best_ious` (N,), 0 to 1, has each touch's best imprint IoU with any pose tried. The touches are `contradictory` if
    the best hypothesis has a far lower imprint IoU with one of them. `outliers` are the touches that contradict all
    others, while the others agree. There are no outliers if the wrong touch is unknown, as with two touches.
    """

    best_ious: tuple[float, ...] = ()
    outliers: tuple[int, ...] = ()
    contradictory: bool = False
