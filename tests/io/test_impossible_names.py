"""Impossible file names, and paths that are not files, are refused like missing files."""

import os
from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc import Recording, load_object
from tactile_loc.core.runtime.errors import (
    CalibrationError,
    ConfigError,
    ObjectError,
    RecordingError,
    ResultError,
    SensorError,
    TouchError,
    UnknownPluginError,
)
from tactile_loc.io.config import find_sensor_kind
from tactile_loc.io.toml import read_toml
from tactile_loc.io.touches import read_contents
from tactile_loc.plugin import registry
from tactile_loc.reports import find_result
from tactile_loc.sensors.calibration.folder import read_calibration
from tactile_loc.sensors.calibration.frames import read_frames

NAMES = ["x" * 5000, "/nowhere/" + "x" * 300, "a\x00b", "x" * 5000 + ".toml"]
READERS = {
    "mesh": (load_object, ObjectError),
    "toml": (read_toml, ConfigError),
    "touch": (lambda name: read_contents(Path(name)), TouchError),
    "calibration": (lambda name: read_calibration(Path(name)), CalibrationError),
    "recording": (Recording, RecordingError),
    "result": (lambda name: find_result(Path(name)), ResultError),
    "frames": (lambda name: read_frames(Path(name)), CalibrationError),
    "sensor": (
        lambda name: registry().create("sensor", find_sensor_kind(name) or name, {"path": name}),
        (CalibrationError, SensorError, UnknownPluginError),
    ),
}


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
@pytest.mark.parametrize("reader", READERS)
def test_an_impossible_file_name_is_refused(reader, name):
    if reader == "recording":
        pytest.importorskip("mcap")
    read, error = READERS[reader]
    with pytest.raises(error, match=naming(name[:40].replace("\0", "\\x00"))):
        read(name)


def test_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "list.toml")
    with pytest.raises(ConfigError, match=r"list\.toml"):
        read_toml(tmp_path / "list.toml")
    with pytest.raises(ConfigError, match="/dev/zero"):
        read_toml("/dev/zero")
