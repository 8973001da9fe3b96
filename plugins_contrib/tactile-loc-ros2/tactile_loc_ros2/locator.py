"""From an image message to the located frame and the pose message. Nothing of ROS is needed: messages are given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tactile_loc import (
    Localizer,
    LocatedFrame,
    RosPose,
    TactileLocError,
    Touch,
    decode_image,
    touch_from_image,
)

Estimator = Callable[[Touch], LocatedFrame]


class ImageLocator:
    """Locates an object in image messages of one sensor, each for itself.

    `frame` is the sensor's, by default as each image says; `press_depth_m`, metres, as for `tactile_loc.read_touch`; an
    `estimator` says what a touch comes to, by default what the localizer finds.
    """

    def __init__(
        self, localizer: Localizer, frame: str = "", press_depth_m: float | None = None,
        estimator: Estimator | None = None,
    ) -> None:  # fmt: skip
        self._sensor, self._frame, self._press_depth_m = localizer.sensor, frame, press_depth_m
        self._estimator = estimator or (lambda touch: LocatedFrame.of(localizer.localize(touch)))

    def locate(self, image: Any) -> LocatedFrame:
        """Return what a sensor_msgs Image or CompressedImage comes to; never raises for what an image shows."""
        try:
            return self._estimator(touch_from_image(decode_image(image), self._sensor, self._press_depth_m))
        except TactileLocError as error:
            return LocatedFrame.of_error(error)

    def fill(self, message: Any, located: LocatedFrame, image: Any) -> Any:
        """Return a geometry_msgs PoseWithCovarianceStamped, filled: the image's stamp, the sensor's frame, the pose.

        `located` must have a pose.
        """
        assert located.T_sensor_object is not None
        pose = RosPose.of(located.T_sensor_object, located.covariance)
        message.header.stamp = image.header.stamp
        message.header.frame_id = self._frame or image.header.frame_id
        for field, value in zip("xyz", pose.position_m, strict=True):
            setattr(message.pose.pose.position, field, value)
        for field, value in zip("xyzw", pose.quaternion_xyzw, strict=True):
            setattr(message.pose.pose.orientation, field, value)
        message.pose.covariance = list(pose.covariance)
        return message
