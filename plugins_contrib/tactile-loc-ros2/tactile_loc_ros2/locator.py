"""Locating the object in image messages, each image separately or as a track. This module does not import ROS."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import (
    Localizer,
    LocatedFrame,
    NoContactError,
    TactileLocError,
    Touch,
    Tracker,
    Verdict,
    decode_image,
    touch_from_image,
)
from tactile_loc.plugin.helpers import make_contact_cloud

from tactile_loc_ros2.frames import NS, read_stamp_ns

Floats = NDArray[np.float64]
Estimator = Callable[[Touch], LocatedFrame]

RESET_S = 1.0  # stamps that go back farther begin another track


@dataclass(frozen=True, eq=False)
class LocatedImage:
    """The result of one image, with poses in the sensor's frame, and its touch; None without contact.

    In a track, `slipped` states whether the object has just moved.
    """

    located: LocatedFrame
    touch: Touch | None = None
    slipped: bool = False

    @property
    def contact_points_m(self) -> Floats:
        """The surface in contact (N, 3), metres, in the sensor's frame."""
        if self.touch is None:
            return np.empty((0, 3))
        return make_contact_cloud(self.touch.contact_shape, self.touch.geometry, walls=False)[0]


class ImageLocator:
    """Locates an object in image messages of one sensor, each image separately or, with `track`, as one sequence.

    `press_depth_m`, in metres, has the same meaning as in `tactile_loc.read_touch`. `estimator` locates a touch without
    a track; the default estimator uses the localizer. If a verdict is `required`, poses with another verdict are not
    published.
    """

    def __init__(
        self,
        localizer: Localizer,
        press_depth_m: float | None = None,
        estimator: Estimator | None = None,
        required: Verdict | None = None,
        track: bool = False,
    ) -> None:
        self.localizer, self.required = localizer, required
        self._press_depth_m, self._estimator = press_depth_m, estimator or self._localize
        self._tracker = Tracker(localizer, live=True) if track else None
        self._time_s = -math.inf

    def read_touch(self, image: Any, T_base_sensor: Floats | None = None) -> Touch:
        """Return the touch of a sensor_msgs Image or CompressedImage, with the sensor's pose (4, 4), metres.

        Raises NoContactError if nothing touches the gel, and TactileLocError if the image cannot be read.
        """
        asked, pixels = self.localizer.config.touch, decode_image(image)
        touch = touch_from_image(pixels, self.localizer.sensor, self._press_depth_m, unit=asked.unit, kind=asked.kind)
        return replace(touch, T_base_sensor=T_base_sensor)

    def locate(self, image: Any, T_base_sensor: Floats | None = None) -> LocatedImage:
        """Locate the object in an image message. A faulty image gives a result with the error.

        A track needs the sensor's pose `T_base_sensor` (4, 4), metres. Without it, the sensor is assumed to rest.
        """
        try:
            return self._locate(image, T_base_sensor)
        except TactileLocError as error:
            return LocatedImage(LocatedFrame.of_error(error))

    def is_published(self, located: LocatedFrame) -> bool:
        """Return whether the pose of a result is published: there is a pose, and it has the required verdict."""
        has_verdict = self.required is None or located.verdict is self.required
        return located.T_sensor_object is not None and has_verdict

    def _locate(self, image: Any, T_base_sensor: Floats | None) -> LocatedImage:
        touch: Touch | None = None
        says = ""
        if self._tracker is None:
            touch = self.read_touch(image, T_base_sensor)
            return LocatedImage(self._estimator(touch), touch)
        try:
            touch = self.read_touch(image, T_base_sensor)
        except NoContactError as error:
            says = str(error)
        tracker, time_s = self._follow_clock(read_stamp_ns(image.header) / NS)
        pose = tracker.update(time_s, touch, np.eye(4) if T_base_sensor is None else T_base_sensor)
        return LocatedImage(replace(pose, says=says), touch, pose.slipped)

    def _follow_clock(self, time_s: float) -> tuple[Tracker, float]:
        """Return the tracker and the time of an image, seconds; a reset clock begins another track."""
        if self._tracker is None or time_s < self._time_s - RESET_S:
            self._tracker, self._time_s = Tracker(self.localizer, live=True), time_s
        self._time_s = max(self._time_s, time_s)  # images may arrive out of order
        return self._tracker, self._time_s

    def _localize(self, touch: Touch) -> LocatedFrame:
        return LocatedFrame.of(self.localizer.localize(touch))
