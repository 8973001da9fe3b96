#!/usr/bin/env python3
"""Faults that are planted in real photos, and what the checks of `tactile-loc doctor --sensor` find.

The public sets are those of `real_images.py`. Of five presses, three calibrate the sensor as `tactile-loc calibrate`
does. One belongs to the photos `tuned`, with which the limits of the checks were chosen, and one to the photos
`held-out`. A fault is found if one of the checks that are named for it finds a fault.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from asked import make_data_parser, write_head
from numpy.typing import NDArray
from PIL import Image as Picture
from real_images import SETS
from scipy.ndimage import affine_transform, gaussian_filter

from tactile_loc import calibrate_folder, convert_presses, label_presses, read_photo
from tactile_loc.sensors.calibration.folder import Calibration, read_calibration
from tactile_loc.sensors.calibration.press_table import read_rows
from tactile_loc.sensors.reading.passport import examine_photos
from tactile_loc.sensors.reading.reading import reduce_image

Image = NDArray[np.uint8]
Photos = Sequence[Image]
PARTS = {"tuned": 3, "held-out": 4}  # remainder of a press's number when it is divided by EVERY
EVERY = 5
STRETCH, BRIGHTER, LEFT, DENT, DARKER = 1.15, 0.12, 0.6, 0.5, 0.4
STUCK, SCRATCHES = 12, 60.0  # number of dead pixels, and height of scratches, counts


def convert(values: NDArray[np.floating]) -> Image:
    """Return values as counts."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def stretch(photo: Image, _: NDArray[np.float64]) -> Image:
    """Stretch a photo along x about its middle."""
    middle = (photo.shape[1] - 1) / 2
    step, start = [1, 1 / STRETCH], [0, middle - middle / STRETCH]
    planes = [affine_transform(photo[..., k].astype(float), step, start, order=1, mode="nearest") for k in range(3)]
    return convert(np.stack(planes, axis=-1))


def stick(photo: Image, _: NDArray[np.float64]) -> Image:
    """Set the same random pixels to black and white."""
    rng, made = np.random.default_rng(3), photo.copy()
    rows, columns = (rng.integers(0, size, STUCK) for size in photo.shape[:2])
    made[rows[::2], columns[::2]], made[rows[1::2], columns[1::2]] = 0, 255
    return made


def scratch(photo: Image, _: NDArray[np.float64]) -> Image:
    """Add the same fine structure."""
    fine = gaussian_filter(np.random.default_rng(5).normal(0, 1, photo.shape[:2]), 1.5)
    fine /= np.abs(fine).max()
    return convert(photo + SCRATCHES * (fine * (np.abs(fine) > 0.35))[..., None])


def dent(photos: Photos, gel: NDArray[np.float64]) -> list[Image]:
    """Add the faint imprint of the first press, blurred and at another place, to all photos."""
    faint = DENT * gaussian_filter(photos[0] - gel, (3, 3, 0))
    return [convert(photo + np.roll(faint, photo.shape[1] // 3, axis=1)) for photo in photos]


def brighten(photos: Photos, _: NDArray[np.float64]) -> list[Image]:
    """Brighten the photos step by step."""
    return [convert(photo * (1 + BRIGHTER * number / (len(photos) - 1))) for number, photo in enumerate(photos)]


def each(change: Callable[[Image, NDArray[np.float64]], Image]) -> Callable[[Photos, NDArray[np.float64]], list[Image]]:
    """Return the fault that changes each photo alone."""
    return lambda photos, gel: [np.ascontiguousarray(change(photo, gel)) for photo in photos]


CLEAN = "none (clean photos)"
ORDER, SURFACE = "order of colours and pixels", "surface of the gel"
ZERO, OTHER = "zero image", "same sensor"  # planted in the sensor, or taken from another set
FAULTS: Mapping[str, tuple[set[str], Callable[[Photos, NDArray[np.float64]], list[Image]]]] = {
    "red and blue swapped": ({ORDER}, each(lambda photo, _: photo[..., ::-1])),
    "left and right swapped": ({ORDER}, each(lambda photo, _: photo[:, ::-1])),
    "turned by 180°": ({ORDER}, each(lambda photo, _: photo[::-1, ::-1])),
    "stretched along x": ({"equal scales"}, each(stretch)),
    "permanent dent": ({"offset without contact"}, dent),
    "drifting light": ({"drift"}, brighten),
    "dead pixels": ({"dead pixels"}, each(stick)),
    "weak gel": ({"contrast of the gel"}, each(lambda photo, gel: convert(gel + LEFT * (photo - gel)))),
    "scratched gel": ({SURFACE}, each(scratch)),
    "dark lamp": ({"lamps"}, each(lambda photo, _: convert(photo * np.array([DARKER, 1, 1])))),
}


def split(name: str, data: Path, presses: Path) -> dict[str, list[Image]]:
    """Write the photos of a set to the folder `presses`, find the balls in some, and return the other photos.

    The labels of the sets are not used: those of FOTS are up to 8 pixels beside the imprints.
    """
    source, ball_radius_mm, mm_per_px, _ = SETS[name]
    table = convert_presses(data / source, presses, ball_radius_mm, mm_per_px)
    balls = [row.image for row in read_rows(table) if row.kind == "ball"]
    photos = {part: [read_photo(path) for path in balls[k::EVERY]] for part, k in PARTS.items()}
    for path in (table, *(path for k in PARTS.values() for path in balls[k::EVERY])):
        path.unlink()
    label_presses(presses, None, ball_radius_mm, mm_per_px)
    return photos


def find_faults(sensor: Calibration, photos: Photos) -> set[str]:
    """Return the names of the checks that find a fault."""
    return {one.check.name for one in examine_photos(sensor.examine(photos)) if one.is_fault}


def plant(sensor: Calibration, photos: Photos, other: Photos) -> dict[str, tuple[bool, set[str]]]:
    """Return for each planted fault, and for the clean photos, whether the result is right, and what is found."""
    shape = photos[0].shape
    gel = np.asarray(Picture.fromarray(sensor.background).resize(shape[1::-1]), np.float64)
    found = {fault: find_faults(sensor, change(photos, gel)) for fault, (_, change) in FAULTS.items()}
    results = {fault: (bool(FAULTS[fault][0] & names), names) for fault, names in found.items()}
    touched = replace(sensor, untouched=reduce_image(photos[0], sensor.geometry.shape))
    names = find_faults(touched, photos[1:])
    results["touch in the zero image"] = ZERO in names, names
    resized = [np.asarray(Picture.fromarray(photo).resize(shape[1::-1])) for photo in other]
    names = find_faults(sensor, resized)
    results["another sensor"] = OTHER in names, names
    names = find_faults(sensor, photos)
    return {CLEAN: (not names, names), **results}


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = make_data_parser(__doc__)
    parser.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    arguments = parser.parse_args()
    results: dict[str, dict[str, dict[str, tuple[bool, set[str]]]]] = {part: {} for part in PARTS}
    with tempfile.TemporaryDirectory() as temporary:
        folders = {name: Path(temporary) / str(number) for number, name in enumerate(SETS)}
        photos = {name: split(name, arguments.data, folder / "presses") for name, folder in folders.items()}
        for name in arguments.sets:
            presses, out = folders[name] / "presses", folders[name] / "sensor"
            calibrate_folder(presses, presses / "sensor.toml").write(out)
            other = photos[list(SETS)[list(SETS).index(name) - 1]]
            for part in PARTS:
                results[part][name] = plant(read_calibration(out), photos[name][part], other[part])
    for part, of_sets in results.items():
        print(write_head(f"planted fault, {part} photos", *of_sets))
        for fault in next(iter(of_sets.values())):
            print(f"| {fault} | {' | '.join(write_cell(fault, *found[fault]) for found in of_sets.values())} |")
        print()


def write_cell(fault: str, right: bool, names: set[str]) -> str:
    """Return a cell: whether the planted fault is found, and which others are found instead."""
    listed = ", ".join(sorted(names)) or "nothing"
    if fault == CLEAN:
        return "none found" if right else f"found: {listed}"
    return "found" if right else f"not found ({listed})"


if __name__ == "__main__":
    main()
