"""Starts the node tactile_loc. Each option of the node is an argument; `params_file` is a file of parameters."""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from tactile_loc_ros2.options import OPTIONS, read_text

UNSET = ""  # an argument without a value; the parameter file, or else the node's default, decides
COMMON = {"params_file": "file (.yaml) of parameters", "namespace": "the node's namespace", "name": "the node's name"}


def start_node(context: LaunchContext) -> list[Any]:
    """Return the node with the arguments that were given."""

    def get(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    chosen = {one.name: read_text(one, get(one.name)) for one in OPTIONS if get(one.name) != UNSET}
    files = [get("params_file")] if get("params_file") != UNSET else []
    program = {"package": "tactile_loc_ros2", "executable": "tactile-loc-ros2", "output": "screen"}
    named = {"name": get("name") or "tactile_loc", "namespace": get("namespace")}
    return [Node(**program, **named, parameters=[*files, *([chosen] if chosen else [])])]


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    texts = COMMON | {one.name: one.metadata["help"] for one in OPTIONS}
    arguments = [DeclareLaunchArgument(name, default_value=UNSET, description=text) for name, text in texts.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=start_node)])
