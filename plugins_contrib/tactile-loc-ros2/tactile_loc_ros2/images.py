"""The images that wait for their sensor's pose, which may arrive later than the image. This module imports no ROS."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import TactileLocError
from tactile_loc.plugin import TouchError

Floats = NDArray[np.float64]
LookUp = Callable[[Any], Floats | None]

MOST_WAITING = 20
RECENT = 5  # images from which a service takes its touch


@dataclass(frozen=True, eq=False)
class PlacedImage:
    """An image message, and its sensor's pose `T_base_sensor` (4, 4), metres; None without a base frame."""

    image: Any
    T_base_sensor: Floats | None


class ImageQueue:
    """Image messages in the order of their arrival.

    `look_up` returns the sensor's pose for an image, and raises TactileLocError if it is not known. An image waits for
    it for at most `wait_s` seconds. At most MOST_WAITING images wait.
    """

    def __init__(self, look_up: LookUp, wait_s: float) -> None:
        self._look_up, self._wait_s = look_up, wait_s
        self._waiting: deque[tuple[float, Any]] = deque()
        self._recent: deque[Any] = deque(maxlen=RECENT)

    def add(self, image: Any, now_s: float, waits: bool = True) -> None:
        """Add an image that arrives at `now_s`, seconds of a clock that is never set back."""
        self._recent.append(image)
        if waits:
            self._waiting.append((now_s, image))

    def take(self) -> PlacedImage | None:
        """Take the newest image whose sensor pose is known, and drop all older ones; None if there is none."""
        for k in reversed(range(len(self._waiting))):
            image = self._waiting[k][1]
            try:
                placed = PlacedImage(image, self._look_up(image))
            except TactileLocError:
                continue
            for _ in range(k + 1):
                self._waiting.popleft()
            return placed
        return None

    def expire(self, now_s: float) -> list[tuple[Any, TactileLocError]]:
        """Remove the images that have waited too long, and return each with the reason."""
        expired = []
        while self._waiting and self._is_late(now_s):
            _, image = self._waiting.popleft()
            try:
                self._look_up(image)
            except TactileLocError as error:
                expired.append((image, error))
        return expired

    def find_newest(self, topic: str) -> PlacedImage:
        """Return the newest image whose sensor pose is known, for a service.

        Raises TouchError if no image has arrived on `topic`, and the newest image's error if no pose is known.
        """
        if not self._recent:
            raise TouchError(f"no image has arrived on {topic}; check the topic and the sensor")
        for image in reversed(self._recent):
            try:
                return PlacedImage(image, self._look_up(image))
            except TactileLocError:
                continue
        newest = self._recent[-1]
        return PlacedImage(newest, self._look_up(newest))

    def _is_late(self, now_s: float) -> bool:
        return len(self._waiting) > MOST_WAITING or now_s - self._waiting[0][0] >= self._wait_s
