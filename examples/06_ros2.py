"""Send a located pose to ROS 2 as PoseWithCovarianceStamped. Without ROS, the same message is only encoded."""

import argparse
import time

import matplotlib.pyplot as plt
import numpy as np
from rosbags.typesys import Stores, get_typestore

from tactile_loc import Localizer, RosPose, localize_together, save_figure

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--picture", metavar="PATH", help="draw the frames as PNG")
picture = parser.parse_args().picture
NAME, PARTS = "geometry_msgs/msg/PoseWithCovarianceStamped", ("Point", "Quaternion", "Pose", "PoseWithCovariance")

try:
    import rclpy
    from builtin_interfaces.msg import Time
    from geometry_msgs.msg import Point, Pose, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion
    from std_msgs.msg import Header
except ImportError:
    rclpy, types = None, get_typestore(Stores.ROS2_HUMBLE)
    Point, Quaternion, Pose, PoseWithCovariance = (types.types[f"geometry_msgs/msg/{part}"] for part in PARTS)
    PoseWithCovarianceStamped, Time = types.types[NAME], types.types["builtin_interfaces/msg/Time"]
    Header = types.types["std_msgs/msg/Header"]

localizer = Localizer.create("pin", sensor="gelsight-mini")
touches = localizer.simulate_together(2, seed=3)  # T_base_sensor comes from tf, at the stamp of the image
best = localize_together([(localizer, touch) for touch in touches]).best

# ROS has metres, quaternions with the scalar last, and covariances of x, y, z, then rotations about fixed axes.
pose = RosPose.of(best.T_base_object, best.base_covariance)
header = Header(stamp=Time(sec=int(time.time()), nanosec=0), frame_id="base_link")
position, orientation = (
    Kind(**dict(zip(names, map(float, values), strict=True)))
    for Kind, names, values in ((Point, "xyz", pose.position_m), (Quaternion, "xyzw", pose.quaternion_xyzw))
)
at = PoseWithCovariance(pose=Pose(position=position, orientation=orientation), covariance=np.array(pose.covariance))
message = PoseWithCovarianceStamped(header=header, pose=at)

if rclpy is None:
    data = bytes(types.serialize_cdr(message, NAME))
    print(f"rclpy is not installed; the message has {len(data)} bytes in CDR, the encoding of ROS 2")
else:
    rclpy.init()
    node = rclpy.create_node("tactile_loc_example")
    publisher = node.create_publisher(PoseWithCovarianceStamped, "object_pose", 1)
    while not publisher.get_subscription_count():
        time.sleep(0.1)  # the message would be lost
    publisher.publish(message)

if picture:
    axes = plt.figure(figsize=(5, 5), layout="constrained").add_subplot(projection="3d")
    for name, T in {"object": pose.T, **{touch.name: touch.T_base_sensor for touch in touches}}.items():
        for axis, colour in zip(T[:3, :3].T, "rgb", strict=True):
            axes.plot(*(1e3 * (T[:3, 3] + np.outer([0, 0.015], axis))).T, colour)
        axes.text(*(1e3 * T[:3, 3]), name)
    axes.set(xlabel="x of base_link (mm)", ylabel="y (mm)", zlabel="z (mm)", aspect="equal")
    save_figure(picture, axes.figure)
