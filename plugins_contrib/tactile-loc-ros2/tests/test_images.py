"""Images that wait for their sensor's pose."""

import numpy as np
import pytest
from tactile_loc import TactileLocError

from tactile_loc_ros2 import images
from tactile_loc_ros2.images import ImageQueue


class Poses:
    """Sensor poses by image; others are unknown."""

    def __init__(self, *known: str) -> None:
        self.known = set(known)

    def __call__(self, image: str) -> np.ndarray:
        if image not in self.known:
            raise TactileLocError(f"the pose of {image} is unknown")
        return np.eye(4)


def test_the_newest_image_with_a_known_pose_is_taken_once():
    queue = ImageQueue(Poses("a", "b"), wait_s=1)
    for now_s, image in enumerate("abc"):
        queue.add(image, now_s)
    assert queue.take().image == "b"
    assert queue.take() is None  # "a" is older, and "c" has no pose


def test_an_image_is_taken_when_its_pose_comes():
    poses = Poses()
    queue = ImageQueue(poses, wait_s=1)
    queue.add("a", 0)
    assert queue.take() is None
    poses.known.add("a")
    assert queue.take().image == "a"


def test_images_expire_with_their_reason():
    queue = ImageQueue(Poses(), wait_s=1)
    queue.add("a", 0)
    queue.add("b", 0.5)
    assert queue.expire(0.9) == []
    ((image, error),) = queue.expire(1.2)
    assert (image, str(error)) == ("a", "the pose of a is unknown")
    assert [image for image, _ in queue.expire(9)] == ["b"]
    assert queue.expire(99) == []


def test_few_images_wait():
    queue = ImageQueue(Poses(), wait_s=1e9)
    for k in range(images.MOST_WAITING + 3):
        queue.add(str(k), 0)
    assert [image for image, _ in queue.expire(0)] == ["0", "1", "2"]


def test_a_service_gets_the_newest_image_with_a_known_pose():
    poses = Poses("a")
    queue = ImageQueue(poses, wait_s=1)
    with pytest.raises(TactileLocError, match="no image has arrived on /gel"):
        queue.find_newest("/gel")
    for image in "ab":
        queue.add(image, 0, waits=False)
    assert queue.find_newest("/gel").image == "a"
    assert queue.take() is None
    poses.known.clear()
    with pytest.raises(TactileLocError, match="the pose of b"):
        queue.find_newest("/gel")
    poses.known.add("b")
    assert queue.find_newest("/gel").image == "b"


def test_a_service_gets_no_old_image():
    queue = ImageQueue(Poses("0"), wait_s=1)
    for k in range(images.RECENT + 1):
        queue.add(str(k), 0)
    with pytest.raises(TactileLocError, match="unknown"):
        queue.find_newest("/gel")
