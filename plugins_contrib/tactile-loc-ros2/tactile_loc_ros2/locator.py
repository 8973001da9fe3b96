"""Locating the object in image messages, and filling pose messages. This module does not import ROS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tactile_loc import (
    Localizer,
    LocatedFrame,
    RosPose,
    TactileLocError,
    Touch,
    Verdict,
    decode_image,
    touch_from_image,
)

Estimator = Callable[[Touch], LocatedFrame]


class ImageLocator:
    """Locates an object in image messages of one sensor, each image separately.

    `frame` is the sensor's frame, by default the frame in the image's header. `press_depth_m`, in metres, has the same
    meaning as in `tactile_loc.read_touch`. `estimator` locates a touch; the default estimator uses the localizer. If a
    verdict is `required`, poses with another verdict are not published.
    """

    def __init__(
        self, localizer: Localizer, frame: str = "", press_depth_m: float | None = None,
        estimator: Estimator | None = None, required: Verdict | None = None,
    ) -> None:  # fmt: skip
        self._sensor, self._frame, self._press_depth_m = localizer.sensor, frame, press_depth_m
        self._required = required
        self._estimator = estimator or (lambda touch: LocatedFrame.of(localizer.localize(touch)))

    def locate(self, image: Any) -> LocatedFrame:
        """Locate the object in a sensor_msgs Image or CompressedImage. A faulty image gives a result with the error."""
        try:
            return self._estimator(touch_from_image(decode_image(image), self._sensor, self._press_depth_m))
        except TactileLocError as error:
            return LocatedFrame.of_error(error)

    def is_published(self, located: LocatedFrame) -> bool:
        """Return whether the pose of a result is published: there is a pose, and it has the required verdict."""
        has_verdict = self._required is None or located.verdict is self._required
        return located.T_sensor_object is not None and has_verdict

    def fill(self, message: Any, located: LocatedFrame, image: Any) -> Any:
        """Fill a geometry_msgs PoseWithCovarianceStamped with the image's stamp, the sensor's frame and the pose.

        `located` must have a pose. Returns the message.
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
