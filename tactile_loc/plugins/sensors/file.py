"""A sensor described by a TOML file. docs/files.md lists the keys, and examples/my_sensor.toml is an example."""

from pathlib import Path
from typing import Any

from pydantic import Field

from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.plugin import SensorGeometry
from tactile_loc.plugin.helpers import DepthSensor, GelOptions


class FileSensor(DepthSensor):
    """The sensor that a TOML file describes.

    Raises SensorError, which names the file, the key and the allowed values, when the file is wrong.
    """

    class Options(GelOptions):
        """The `path` of the sensor file."""

        path: str = Field(description="the sensor file (TOML)")

    def describe(self) -> dict[str, Any]:
        """Return JSON values that identify the sensor by the file's content, not by its path."""
        return {**super().describe(), "options": self.geometry.describe()}

    def _make_geometry(self) -> SensorGeometry:
        return read_sensor_file(Path(self.options.path).expanduser())
