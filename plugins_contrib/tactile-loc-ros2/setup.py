"""Installs the package and the files that ROS 2 looks for, with the metadata of pyproject.toml.

`colcon build --symlink-install` runs a link to this file in a folder without pyproject.toml, so this file reads it.
"""

import tomllib
from pathlib import Path

from setuptools import setup

NAME = "tactile_loc_ros2"
PROJECT = tomllib.loads(Path(__file__).resolve().with_name("pyproject.toml").read_text(encoding="utf-8"))["project"]

setup(
    name=PROJECT["name"],
    version=PROJECT["version"],
    license="MIT",
    packages=[NAME],
    entry_points={"console_scripts": [f"{name} = {function}" for name, function in PROJECT["scripts"].items()]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/tactile_loc.launch.py"]),
        (f"share/{NAME}/config", ["config/tactile_loc.yaml"]),
    ],
)
