"""Reads folders of presses: images, a table of labels and a sensor file (docs/sensors.md)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.runtime.errors import CalibrationError, TactileLocError, name_source
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.photo_map import PhotoMap
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.images import read_photo
from tactile_loc.sensors.calibration.gel_fit import BallImage, GelFit, fit_gel, label_elastic_ball, press_balls
from tactile_loc.sensors.calibration.labels import STEEPEST, Image, PressLabel, label_ball
from tactile_loc.sensors.calibration.press_table import BALL, TABLE, UNTOUCHED, PressRow, read_rows
from tactile_loc.sensors.calibration.reflectance import BallContact, SeenBalls
from tactile_loc.sensors.calibration.statement import UNCHECKED, Statement, check_statement
from tactile_loc.sensors.reading.circles import Circle
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.reading import reduce_image
from tactile_loc.sensors.reading.rectification import Stretch, measure_stretch
from tactile_loc.store.keys import hash_arrays, hash_file

MOST_READ_PX = 200  # longer image side; twice this size takes four times as long and does not improve the poses
SAME_SHAPE = 0.01  # largest relative difference of the aspect ratio of a smaller image
FOR_MEDIAN = 9  # fewest presses, at different places, whose median shows the untouched gel


@dataclass(frozen=True, eq=False)
class PressFolder:
    """The presses of balls in a table, with their images in memory.

    `images` have the size of `geometry`. `camera` is the geometry of the images before they were reduced. The circles
    in the table are in pixels of `camera`. If there is a `photo_map`, photos were rectified by it. `stretch` is
    what their imprints show, if it was measured. Marker dots are filled in, in the images and in the background; `gel`
    has the background with its dots. `fit` is the gel's elasticity, if it is known. The labels follow from it, and from
    the balls' `contacts`, in pixels of `geometry`. `statement` is what the presses show about the stated radii.
    """

    rows: tuple[PressRow, ...]
    images: tuple[Image, ...]
    gel: UntouchedGel
    geometry: SensorGeometry
    camera: SensorGeometry
    fit: GelFit | None = None
    photo_map: PhotoMap | None = None
    stretch: Stretch | None = None
    contacts: tuple[BallContact, ...] = ()
    statement: Statement = UNCHECKED

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def background(self) -> Image:
        """The image (H, W, 3) of the untouched gel, without marker dots."""
        return self.gel.clear

    @property
    def untouched(self) -> Image:
        """The image (H, W, 3) of the untouched gel, with its marker dots."""
        return self.gel.image

    def read_press(self, number: int) -> tuple[Image, PressLabel]:
        """Return the image (H, W, 3) and the label of a press. Raises CalibrationError as `label` does."""
        return self.images[number], self.label(number)

    def read_presses(self, numbers: Iterable[int]) -> Iterator[tuple[Image, PressLabel]]:
        """Yield the images and the labels of some presses. Raises CalibrationError as `label` does."""
        return map(self.read_press, numbers)

    def name(self, number: int) -> str:
        """Return the name of a press's image."""
        return self.rows[number].image.name

    def label(self, number: int) -> PressLabel:
        """Return the label of a press. Raises CalibrationError, which names the row, when the label is impossible."""
        with name_source(self.rows[number].where):
            ball = self.read_ball(number)
            label = label_ball(self.geometry, (ball.circle.x_px, ball.circle.y_px), ball.circle.radius_px, ball.ball_m)
            if self.fit is None or not self.fit.is_elastic:
                return label
            x_px, y_px, contact_m = self.contacts[number]
            return label_elastic_ball(self.geometry, (x_px, y_px), contact_m, press_balls(self.fit.gel, ball.ball_m))

    def read_balls(self) -> list[BallImage]:
        """Return the images of the balls, with their circles in pixels of the images."""
        return [self.read_ball(number) for number in range(len(self))]

    def read_ball(self, number: int) -> BallImage:
        """Return the image of a ball, with its circle in pixels of the image."""
        x, y, radius, ball_mm = (self.rows[number].read_number(column) for column in BALL)
        (rows, columns), (height, width) = self.geometry.shape, self.camera.shape
        pitch_m = self.geometry.pixel_pitch_m
        circle = Circle(x * columns / width, y * rows / height, radius * self.camera.pixel_pitch_m / pitch_m)
        return BallImage(self.images[number], circle, 1e-3 * ball_mm, pitch_m)

    def measure_gel(self, progress: Progress | None = None) -> PressFolder:
        """Return the presses with the gel's elasticity and the check of the balls' radii, if the gel is flat."""
        if self.geometry.is_curved:
            return self
        balls = self.read_balls()
        fit = fit_gel(balls, self.background, progress)
        measured = replace(self, fit=fit, statement=check_statement(balls, self.background))
        if fit is None or not fit.is_elastic:
            return measured
        fit, contacts = SeenBalls(balls, self.background, self.geometry).fit(fit)
        return replace(measured, fit=fit, geometry=replace(self.geometry, gel=fit.gel), contacts=tuple(contacts))

    def measure_stretch(self) -> PressFolder:
        """Return the presses with the stretch of their photos, if there are enough presses."""
        shown = [(ball.image, ball.circle) for ball in self.read_balls()]
        return replace(self, stretch=measure_stretch(shown, self.background))

    def describe(self) -> dict[str, Any]:
        """Return JSON values that identify the presses and the sensor in store keys."""
        return {
            "table": hash_file(self.rows[0].table),
            "images": [hash_arrays(image=image) for image in self.images],
            "background": hash_arrays(image=self.background),
            "geometry": self.geometry.describe(),
            "camera": self.camera.describe(),
            "fit": None if self.fit is None else self.fit.record(),
        }

    def list_doubts(self) -> list[str]:
        """Return sentences about the balls and the scales, if they cannot be as stated."""
        scales = [] if self.stretch is None else self.stretch.list_doubts(self.camera)
        names, ball_mm = [self.name(number) for number in range(len(self))], 1e3 * self.read_ball(0).ball_m
        return [*scales, *self.statement.list_doubts(names, ball_mm, 1e3 * self.camera.pixel_pitch_m)]

    def list_facts(self) -> list[str]:
        """Return sentences about deep presses, the ball, and the gel: its surface, its elasticity, its dots."""
        facts, relief_m = [*self._list_deep(), *self.statement.list_facts()], self.geometry.relief_m
        if relief_m is not None:
            facts.append(f"the gel is curved: its edge is up to {-1e3 * relief_m.min():.2f} mm lower than its top")
        if self.fit is not None:
            facts.append(self.fit.explain())
        dots = self.record()["dots"]
        if dots["count"]:
            facts.append(
                f"the gel has {dots['count']} marker dots, {1e3 * dots['diameter_m']:.2f} mm wide and "
                f"{1e3 * dots['spacing_m']:.2f} mm apart; they cover {100 * dots['covered']:.0f} % of the image and "
                "are filled in"
            )
        return facts

    def _list_deep(self) -> list[str]:
        """Return a sentence about the presses whose circles are as wide as the ball, if there are any."""
        balls = enumerate(self.read_balls())
        deep = [self.name(n) for n, ball in balls if ball.circle.radius_px * ball.pitch_m > STEEPEST * ball.ball_m]
        names = "all presses" if len(deep) == len(self) else ", ".join(deep)
        return [f"used, but the circle is too wide to show the press depth: {names}"] if deep else []

    def record(self) -> dict[str, Any]:
        """Return the camera's image size, the marker dots, the gel's elasticity and the ball's size, as JSON values.

        The elasticity and the size are left out if the presses do not determine them.
        """
        dots = {"dots": self.gel.record(self.geometry.pixel_pitch_m)}
        gel = {} if self.fit is None else {"gel": self.fit.record()}
        photo = {} if self.photo_map is None else {"photo": self.photo_map.record()}
        ball = {} if self.statement.ratio is None else {"ball": self.statement.record()}
        return {"camera_px": list(self.camera.shape), **photo, **dots, **gel, **ball}


def read_presses(
    folder: Path,
    camera: SensorGeometry,
    median_background: bool = False,
    size_px: tuple[int, int] | None = None,
    photo_map: PhotoMap | None = None,
) -> PressFolder:
    """Read a folder of presses with the table `presses.csv`, taken by a sensor with the geometry `camera`.

    If there is a `photo_map`, photos are rectified by it, and the table and `camera` are in pixels of the result. With
    `size_px` (width, height), images and sensor are reduced to that size. The background is the mean of the table's
    background images. With `median_background`, the background is the pixelwise median of all presses, of which at
    least FOR_MEDIAN are needed. Marker dots are filled in. Raises CalibrationError, which names the faulty row, when
    the folder cannot be used.
    """
    table = folder / TABLE
    geometry = camera if size_px is None else _shrink_sensor(camera, size_px)
    rows = read_rows(table)
    images = {row: reduce_image(_read_image(row, camera, photo_map), geometry.shape) for row in rows}
    unpressed = [image for row, image in images.items() if row.kind == "background"]
    pressed = tuple(row for row in rows if row.kind != "background")
    if not pressed:
        raise CalibrationError(f"{table} lists no press; add rows of kind ball")
    if not unpressed and not median_background:
        raise CalibrationError(
            f"{table} lists no image of the untouched gel; add a row of kind background, or use `background` median "
            "with many presses at different places"
        )
    if median_background and len(pressed) < FOR_MEDIAN:
        raise CalibrationError(
            f"{table} lists {len(pressed)} presses, but `background` median needs at least {FOR_MEDIAN} at different "
            "places; add presses, or a row of kind background"
        )
    stack = np.stack([images[row] for row in pressed] if median_background else unpressed)
    background = np.median(stack, axis=0) if median_background else stack.mean(axis=0)
    gel = UntouchedGel.of(np.rint(background).astype(np.uint8))
    clear = tuple(gel.clear_image(images[row]) for row in pressed)
    presses = PressFolder(pressed, clear, gel, geometry, camera, photo_map=photo_map)
    for number in range(len(presses)):
        presses.label(number)  # reports faulty rows before the training
    return presses


def choose_size_px(camera: SensorGeometry) -> tuple[int, int]:
    """Return the size (width, height), pixels, to which a camera's images are reduced before they are read.

    Each reduced pixel replaces a square of whole pixels. If the gel is about 20 mm wide, a reduced pixel shows about a
    tenth of a millimetre.
    """
    merged = math.ceil(max(camera.shape) / MOST_READ_PX)
    return round(camera.width_px / merged), round(camera.height_px / merged)


def _shrink_sensor(camera: SensorGeometry, size_px: tuple[int, int]) -> SensorGeometry:
    """Return the sensor at a smaller image size (width, height), pixels.

    Raises CalibrationError when the size is larger than the camera's or has another aspect ratio.
    """
    width, height = size_px
    shares = width / camera.width_px, height / camera.height_px
    if not (min(shares) > 0 and max(shares) <= 1 and abs(shares[0] / shares[1] - 1) <= SAME_SHAPE):
        raise CalibrationError(
            f"images of {camera.width_px} x {camera.height_px} px cannot be reduced to {width} x {height} px; give a "
            "smaller size with the same aspect ratio"
        )
    return camera.resize(width, height)


def _read_image(row: PressRow, geometry: SensorGeometry, photo_map: PhotoMap | None) -> Image:
    try:
        image = read_photo(row.image)
        if photo_map is not None and row.image.name != UNTOUCHED:
            image = photo_map.rectify(image)
    except TactileLocError as error:
        raise CalibrationError(f"{row.where}: {error}") from error
    if image.shape[:2] != geometry.shape:
        got, want = (f"{shape[1]} x {shape[0]}" for shape in (image.shape, geometry.shape))
        raise CalibrationError(
            f"{row.where}: {row.image.name} is {got} px but the sensor's image is {want} px (width x height); "
            "all images must have that size"
        )
    return image
