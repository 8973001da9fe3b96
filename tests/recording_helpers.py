"""Write ROS bags."""

from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from tactile_loc.io.streams.ros_messages import IMAGE, make_image

S = 1_000_000_000


def write_bag(path: Path, images: np.ndarray, kind: str = "sqlite") -> Path:
    """Write images (N, H, W, 3), one a second, as a file of ROS 1 ("ros1") or a folder of ROS 2 ("sqlite", "mcap").

    "packed" is a folder of ROS 2 in SQLite, whose messages are compressed.
    """
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    bag = Writer1(path) if kind == "ros1" else Writer2(path, version=9, storage_plugin=plugin)
    if kind == "packed":
        bag.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with bag as writer:
        connection = writer.add_connection("/gel/image", IMAGE, typestore=store)
        for k, image in enumerate(images):
            message = make_image(image, "rgb8", k * S + 7, "gel")
            if kind == "ros1":
                stamp = store.types["builtin_interfaces/msg/Time"](k, 7)
                message.header = store.types["std_msgs/msg/Header"](k, stamp, "gel")
                writer.write(connection, k * S + 9, store.serialize_ros1(message, IMAGE))
            else:
                writer.write(connection, k * S + 9, store.serialize_cdr(message, IMAGE))
    return path
