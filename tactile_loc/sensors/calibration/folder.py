"""The calibration folder: a sensor's geometry, its untouched gel, the trained estimator, and its errors."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tactile_loc.core.runtime.errors import CalibrationError, OutputError, SensorError, TouchError, name_source
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.photo_map import PhotoMap
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.images import read_photo, write_image
from tactile_loc.io.sensor_files import CALIBRATION, PhotoKeys, read_sensor_file, write_sensor_file
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.passport import Examination, require_photos
from tactile_loc.sensors.reading.photometric import PhotometricEstimator
from tactile_loc.sensors.reading.reading import (
    Health,
    Seen,
    measure_health,
    measure_press_m,
    read_gel,
    require_healthy,
    require_image,
)
from tactile_loc.store.files import guard_output, is_unfinished, read_json, recover_folder, replace_folder
from tactile_loc.store.keys import hash_arrays, hash_file

SCHEMA_VERSION = 1
SENSOR, BACKGROUND, WEIGHTS = "sensor.toml", "background.png", "estimator.safetensors"
PICTURE, CHECKED = "held-out.png", "checks"  # a picture's file, and a key of the record
ZERO_ADVICE = "take it with the same sensor and light, or calibrate again"
OURS = {SENSOR, "sensor_mask.png", "sensor_surface.npy", BACKGROUND, CALIBRATION, WEIGHTS, PICTURE}


class _Record(BaseModel):
    """The parts of a calibration's record that are needed to read an image."""

    model_config = ConfigDict(strict=True)

    estimator: Literal["photometric"]
    options: dict[str, Any]
    noise_m: float
    health: dict[str, float | None] | None = None
    photo: PhotoKeys | None = None
    camera_px: Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=2, max_length=2)] = [1, 1]


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated sensor, as read from its `folder`, which holds the weights.

    `record` is the content of calibration.json. Images are compared with `untouched` (H, W, 3), an image of the
    untouched gel. `untouched` is the calibration's `background` or a newer image.
    """

    geometry: SensorGeometry
    background: Image
    untouched: Image
    record: dict[str, Any]
    folder: Path

    @property
    def noise_m(self) -> float:
        """The standard deviation of the estimated indentation where the gel is untouched, metres."""
        return float(self.record["noise_m"])

    @cached_property
    def false_press_m(self) -> float:
        """The press depth that is falsely measured in the image of the untouched gel, metres."""
        return max(0.0, measure_press_m(self.estimator.read(self.gel.clear)[0], self.geometry))

    @cached_property
    def gel(self) -> UntouchedGel:
        """The untouched gel with its marker dots. Raises CalibrationError when they cover too much of the image."""
        with name_source(self.folder):
            return UntouchedGel.of(self.untouched)

    @property
    def camera_px(self) -> tuple[int, int]:
        """The size (rows, columns) of the camera's images before they are reduced to the sensor's size."""
        rows, columns = self.record.get("camera_px", self.geometry.shape)
        return int(rows), int(columns)

    @cached_property
    def photo_map(self) -> PhotoMap | None:
        """The map from the camera's photos to images of equal scale, or None if the photos are these images."""
        record, (rows, columns) = self.record.get("photo"), self.camera_px
        return None if record is None else PhotoMap.of_record(record, (columns, rows))

    def rectify(self, photo: NDArray[Any]) -> NDArray[Any]:
        """Return the image of equal scale of a camera's photo (H, W, 3). An image of the sensor's size is unchanged.

        Raises TouchError for a photo of another size.
        """
        known, shape = self.photo_map, photo.shape
        if known is None or len(shape) != 3 or photo.dtype != np.uint8:
            return photo
        return photo if known.photo_px != shape[1::-1] and shape[:2] == self.geometry.shape else known.rectify(photo)

    @property
    def usual_health(self) -> Health | None:
        """The worst health of the training presses, or None if the record has none."""
        found = self.record.get("health")
        return None if found is None else Health.of_record(found)

    @cached_property
    def estimator(self) -> PhotometricEstimator:
        """The trained estimator. Raises WeightsError when its weights cannot be read."""
        known = self.gel if self.untouched is self.background else UntouchedGel.of(self.background)
        with name_source(self.folder / CALIBRATION):
            estimator = PhotometricEstimator(self.geometry, known.clear, self.record["options"])
        estimator.load(self.folder / WEIGHTS)
        estimator.untouched = self.gel.clear
        return estimator

    def read(self, image: NDArray[Any], gel: Gel | None = None) -> Seen:
        """Return what an image shows.

        The image (H, W, 3) has the size of the camera's images or of the sensor. Marker dots are filled in. `gel`
        replaces the elasticity of the calibration's gel. Raises TouchError when the image is of another sensor, or when
        the sensor has changed much. Logs a warning when it has changed less.
        """
        image = self.gel.clear_image(require_image(self.rectify(image), self.untouched, self.camera_px))
        seen = read_gel(self.estimator, image, gel or self.geometry.gel)
        if self.usual_health is not None:
            require_healthy(measure_health(image, self.gel.clear, seen.slopes, self.geometry), self.usual_health)
        return seen

    def examine(self, photos: Sequence[Image]) -> Examination:
        """Prepare the sensor's checks on photos (H, W, 3) of presses, in the order in which they were taken.

        Raises TouchError for fewer photos than needed, or for another size.
        """
        shown = require_photos([self.rectify(photo) for photo in photos], self.camera_px, self.geometry.shape)
        return Examination(self.estimator, self.gel, shown, self.record.get(CHECKED, {}))

    def describe(self) -> dict[str, Any]:
        """Return JSON values that identify the calibration in store keys."""
        files = {name: hash_file(self.folder / name) for name in (BACKGROUND, WEIGHTS)}
        newer = {} if self.untouched is self.background else {"untouched": hash_arrays(image=self.untouched)}
        photo = {"photo": self.record["photo"]} if self.photo_map is not None else {}
        return {"geometry": self.geometry.describe(), **photo, **files, **newer}


def read_calibration(folder: Path, zero: Path | None = None) -> Calibration:
    """Read a calibrated sensor from its folder. `zero` is the file of a newer image of the untouched gel.

    Raises CalibrationError when a file of the folder is missing or damaged, or when image sizes differ. Raises
    TouchError when `zero` cannot be read, or when its image is of another sensor.
    """
    recover_folder(folder)
    if not os.path.isdir(folder):
        raise CalibrationError(f"there is no folder {folder}; make it with tactile-loc calibrate")
    for name in (SENSOR, BACKGROUND, CALIBRATION, WEIGHTS):
        if not (folder / name).is_file():
            raise CalibrationError(
                f"{folder} is not a calibration folder: it has no {name}; give the folder that "
                "tactile-loc calibrate wrote"
            )
    again = "calibrate the sensor again with tactile-loc calibrate"
    try:
        record = read_json(folder / CALIBRATION)
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{folder / CALIBRATION} cannot be read ({error}); {again}") from error
    if not isinstance(record, dict) or record.get("schema_version") != SCHEMA_VERSION:
        raise CalibrationError(f"{folder / CALIBRATION} is from another version of tactile-loc; {again}")
    try:
        _Record(**record)
    except ValidationError as error:
        wrong = error.errors()[0]["loc"][0]
        raise CalibrationError(
            f"{folder / CALIBRATION} is damaged: {wrong} is missing or has a wrong type; {again}"
        ) from error
    try:
        geometry = read_sensor_file(folder / SENSOR)
        background = read_photo(folder / BACKGROUND)
    except (OSError, ValueError, SensorError, TouchError) as error:
        raise CalibrationError(f"{folder} cannot be read as a calibrated sensor ({error}); {again}") from error
    if background.shape[:2] != geometry.shape:
        raise CalibrationError(f"{folder}: {BACKGROUND} and {SENSOR} have different image sizes; {again}")
    found = Calibration(geometry, background, background, record, folder)
    if zero is None:
        return found
    with name_source(f"{zero} (`zero`)"):
        newer = require_image(found.rectify(read_photo(zero)), background, found.camera_px, ZERO_ADVICE)
    return replace(found, untouched=newer)


def _is_replaceable(path: Path) -> bool:
    """Return whether a file belongs to a calibration, to its writing, or to macOS."""
    return path.name in OURS or path.name.startswith((".DS_Store", "._")) or is_unfinished(path)


def require_replaceable(folder: Path) -> None:
    """Check that a calibrated sensor may be written to `folder`. Raises OutputError if the folder holds other files."""
    if folder.exists() and not (folder.is_dir() and all(map(_is_replaceable, folder.iterdir()))):
        raise OutputError(f"{folder} contains files that do not belong to a calibration; choose another `out`")


def write_calibration(folder: Path, estimator: PhotometricEstimator, untouched: Image, record: dict[str, Any]) -> Path:
    """Write a calibrated sensor to a folder atomically, and return the folder.

    `untouched` (H, W, 3) is the image of the untouched gel, with marker dots. A calibrated sensor that is already in
    the folder is replaced. Raises OutputError when the folder holds other files or cannot be written.
    """
    require_replaceable(folder)
    options = estimator.options.model_dump(mode="json")
    whole = {"schema_version": SCHEMA_VERSION, "estimator": "photometric", "options": options, **record}
    with guard_output(folder), replace_folder(folder) as temporary:
        write_sensor_file(temporary / SENSOR, estimator.geometry)
        write_image(temporary / BACKGROUND, untouched)
        estimator.save(temporary / WEIGHTS)
        (temporary / CALIBRATION).write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    return folder
