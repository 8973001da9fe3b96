"""The node's options: each is a ROS parameter and an option of the command line. This module does not import ROS."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np
from tactile_loc import Localizer, RunConfig, Verdict, write_sensor_file
from tactile_loc.plugin import ConfigError, SensorGeometry

ROS_ARGUMENTS, END_OF_ROS_ARGUMENTS = "--ros-args", "--"
OTHER_SPELLINGS = {"press_depth_mm": ("--press-depth",)}
NEVER, ANY = "never", "any"
POSITIVE = ("tf_keep_s", "mesh_scale", "most_touches", "approach_count")
NOT_NEGATIVE = ("tf_wait_s", "press_depth_mm")


def option(default: Any, text: str, choices: Sequence[str] = ()) -> Any:
    """Return a field with a default, a description, and the values to which it is limited."""
    return field(default=default, metadata={"help": text, "choices": tuple(choices)})


@dataclass(frozen=True)
class NodeOptions:
    """The node's options. Lengths in their names have their unit; an empty text means that nothing was chosen.

    Raises ConfigError for a missing or impossible value.
    """

    object: str = option("", "mesh file or demo object")
    units: str = option("auto", "unit of the mesh files", ("auto", "m", "mm", "cm", "inch"))
    sensor: str = option("", "sensor name, sensor file (.toml), or calibration folder")
    image_topic: str = option("", "images of the gel, or contact shapes (32FC1, metres)")
    camera_info_topic: str = option("", "CameraInfo of depths, which replaces the sensor's image size and rays")
    compressed: bool = option(False, "the images are CompressedImage")
    config: str = option("", "configuration file (.toml) of tactile-loc, for all settings that are not listed here")
    tolerance: str = option("", "largest error of a pose that counts as right in the verdict, such as 0.5mm,2deg")
    confidence: float = option(0.0, "probability from which a pose is certain, 0 to 1; 0: as configured, or 0.95")
    store: str = option("", "folder of built models")
    pose_topic: str = option("/object/pose", "topic of the poses")
    verdict_topic: str = option("/object/verdict", "topic of the verdicts")
    require: str = option("", "publish only poses with this verdict", ("", Verdict.CERTAIN.value))
    frame: str = option("", "the sensor's frame; by default the images' frame")
    base_frame: str = option("", "frame of the poses, in which TF gives the sensor's pose; by default the sensor's")
    object_frame: str = option("object", "the object's frame in TF")
    tf: str = option(NEVER, "verdict at which the object's frame goes to TF", (NEVER, Verdict.CERTAIN.value, ANY))
    tf_wait_s: float = option(0.2, "longest wait for the sensor's pose at an image's stamp, s")
    tf_keep_s: float = option(10.0, "transforms are kept for this time, s")
    press_depth_mm: float = option(0.0, "press depth, mm; 0: measured in each image")
    continuous: bool = option(True, "locate each image; otherwise, only services locate")
    track: bool = option(False, "track the object from image to image")
    detections: bool = option(False, "publish all poses as vision_msgs/Detection3DArray")
    markers: bool = option(True, "publish markers for RViz")
    mesh_resource: str = option("", "URI of a mesh that RViz displays; by default, the node sends triangles")
    mesh_scale: float = option(1.0, "metres per unit of mesh_resource")
    library: tuple[str, ...] = option((), "mesh files of other objects, for the service identify")
    most_touches: int = option(8, "most touches that the services locate together")
    approaches: str = option("", "file (.toml) of approaches for the service next_touch; by default, random ones")
    approach_count: int = option(200, "number of random approaches")

    def __post_init__(self) -> None:
        for one in fields(self):
            chosen, choices = getattr(self, one.name), one.metadata["choices"]
            if choices and chosen not in choices:
                listed = ", ".join(repr(choice) for choice in choices)
                raise ConfigError(f"the option {one.name} cannot be {chosen!r}; choose one of {listed}")
        if not self.image_topic:
            raise ConfigError("the option image_topic is missing; give the topic of the gel's images")
        if not self.config and not (self.object and self.sensor):
            raise ConfigError("the options object and sensor are missing; give both, or a configuration file")
        for name in POSITIVE:
            if not getattr(self, name) > 0:
                raise ConfigError(f"the option {name} cannot be {getattr(self, name)}; give a number above 0")
        for name in NOT_NEGATIVE:
            if not getattr(self, name) >= 0:
                raise ConfigError(f"the option {name} cannot be {getattr(self, name)}; give a number of 0 or more")
        if self.tf != NEVER and not self.object_frame:
            raise ConfigError("the option object_frame is empty, but TF needs a name; give one, or choose tf never")

    @property
    def press_depth_m(self) -> float | None:
        """The press depth, metres; None if it is measured in each image."""
        return 1e-3 * self.press_depth_mm or None

    @property
    def required(self) -> Verdict | None:
        """The verdict without which no pose is published; None if every pose is published."""
        return Verdict(self.require) if self.require else None

    def allows_tf(self, verdict: Verdict | None) -> bool:
        """Return whether a pose with this verdict goes to TF."""
        return self.tf == ANY or (self.tf == Verdict.CERTAIN.value and verdict is Verdict.CERTAIN)

    def make_localizers(self, camera: Any = None) -> tuple[Localizer, list[Localizer]]:
        """Return the object's localizer, and those of the library's objects.

        `camera` is the sensor_msgs CameraInfo of depths, or None for the sensor's own camera. Raises TactileLocError
        for bad input.
        """
        settings: dict[str, Any] = {}
        units: Any
        name, units, symmetry = self.object, self.units, "auto"
        if self.config:
            settings = RunConfig.from_toml(self.config).model_dump(mode="json")
            configured = settings.pop("object")
            touch = settings.pop("touch")
            settings["touch"] = {key: touch[key] for key in ("unit", "kind")}  # of depths
            if not name:
                name, units, symmetry = (configured[key] for key in ("path", "units", "symmetry"))
        if self.sensor:
            settings["sensor"] = choose_sensor(self.sensor)
        if self.tolerance:
            settings["tolerance"] = self.tolerance
        if self.confidence:
            settings["confidence"] = self.confidence
        settings["store"] = self.store or None
        localizer = Localizer.create(name, units=units, symmetry=symmetry, **settings)
        with TemporaryDirectory() as folder:  # localizers read the file only now
            if camera is not None:
                file = write_sensor_file(Path(folder) / "camera.toml", read_camera(camera, localizer.sensor.geometry))
                settings["sensor"] = choose_sensor(str(file))
                localizer = Localizer.create(name, units=units, symmetry=symmetry, **settings)
            return localizer, [Localizer.create(path, units=units, **settings) for path in self.library]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """Make options from the values of ROS parameters. An empty text in a list stands for an empty list."""
        lists = {name: tuple(text for text in values[name] if text) for name in LISTS if name in values}
        return cls(**{**values, **lists})


OPTIONS: tuple[Field[Any], ...] = fields(NodeOptions)
LISTS = tuple(one.name for one in OPTIONS if isinstance(one.default, tuple))


def choose_sensor(name: str) -> str | dict[str, Any]:
    """Return the sensor as given, or as a component if a sensor file or a calibration folder is given."""
    if name.endswith(".toml"):
        return {"name": "file", "options": {"path": name}}
    return {"name": "calibrated", "options": {"path": name}} if Path(name).is_dir() else name


def read_camera(message: Any, geometry: SensorGeometry) -> SensorGeometry:
    """Return a sensor with the image size and the rays of a sensor_msgs CameraInfo; the gel stays as it is.

    The rays are those of rectified images (P), or of the camera (K) if P is zero. Raises SensorError for a CameraInfo
    that is not calibrated.
    """
    P, K = np.reshape(message.p, (3, 4))[:, :3], np.reshape(message.k, (3, 3))
    (fx, _, cx), (_, fy, cy), _ = (P if P[0, 0] else K).tolist()
    width, height = int(message.width), int(message.height)
    return replace(geometry, camera="pinhole", width_px=width, height_px=height, fx=fx, fy=fy, cx=cx, cy=cy)


def read_text(one: Field[Any], text: str) -> Any:
    """Return the value of an option from a text, as in a launch file; the texts of a list are separated by commas.

    Raises ConfigError for a text that is no such value.
    """
    default: Any = one.default
    try:
        if isinstance(default, bool):
            return {"true": True, "false": False}[text.lower()]
        return [part.strip() for part in text.split(",")] if one.name in LISTS else type(default)(text)
    except (KeyError, ValueError) as error:
        kind = "true or false" if isinstance(default, bool) else f"a value of type {type(default).__name__}"
        raise ConfigError(f"the option {one.name} cannot be {text!r}; give {kind}") from error


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line. Options that were not given keep their defaults."""
    says = "Locate an object in images of the gel. Arguments after --ros-args go to ROS."
    parser = argparse.ArgumentParser(prog="tactile-loc-ros2", allow_abbrev=False, description=says)
    for one in OPTIONS:
        names = (f"--{one.name.replace('_', '-')}", *OTHER_SPELLINGS.get(one.name, ()))
        keys: dict[str, Any] = {"dest": one.name, "default": one.default, "help": one.metadata["help"]}
        if isinstance(one.default, bool):
            keys["action"] = argparse.BooleanOptionalAction
        elif isinstance(one.default, tuple):
            keys |= {"nargs": "+", "metavar": "FILE"}
        else:
            keys["type"] = type(one.default)
            keys |= {"choices": one.metadata["choices"]} if one.metadata["choices"] else {"metavar": "VALUE"}
        parser.add_argument(*names, **keys)
    return parser


def split_arguments(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the words for the node, and those for ROS: from each `--ros-args` to the next `--`, or to the end."""
    ours: list[str] = []
    of_ros: list[str] = []
    inside = False
    for word in words:
        if word == ROS_ARGUMENTS:
            inside = True
        if inside:
            of_ros.append(word)
            inside = word != END_OF_ROS_ARGUMENTS
        else:
            ours.append(word)
    return ours, of_ros
