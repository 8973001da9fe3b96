"""Candidate poses, and refined poses."""

from dataclasses import dataclass

from tactile_loc.core.geometry.rigid import Floats


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose to refine: `T_sensor_object` (4, 4), metres, its grid index and log-probability."""

    T_sensor_object: Floats
    index: int
    log_p: float


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """A refined pose `T_sensor_object` (4, 4), metres.

    `contact_iou`, 0 to 1, is the contact IoU with the touch (see `Scene.contact_iou`), or the mean over several
    touches. `covariance` (6, 6) is the covariance of the pose's error, if the refiner estimates it. The error is x, y,
    z of the object frame's origin (m), then a rotation vector (rad). Both are along the sensor's axes, as in ROS's
    PoseWithCovariance. `T_sensors_object` (N, 4, 4), metres, are the object's poses in the frames of several sensors,
    if the refiner corrects the sensors' poses; else None.

    `T_reported_object` (4, 4), metres, is the pose relative to the reported pose of the sensor, which may be wrong.
    It is T_sensor_object unless the refiner corrects the sensor's pose. T_base_object is T_base_sensor @
    T_reported_object. Its `reported_covariance` (6, 6), in the order and axes of `covariance`, includes the errors of
    the sensors' poses. `imprint_iou`, 0 to 1, is the imprint IoU with the touch, or the mean over several touches, if
    the refiner computes it.
    """

    T_sensor_object: Floats
    contact_iou: float
    converged: bool
    iterations: int
    covariance: Floats | None = None
    T_sensors_object: Floats | None = None
    T_reported_object: Floats | None = None
    reported_covariance: Floats | None = None
    imprint_iou: float | None = None
