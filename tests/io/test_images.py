"""Pictures: the colours of photos, whatever way they are stored, and pictures that are no photos."""

from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from PIL import Image

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.runtime.limits import MOST_SIDE_PX
from tactile_loc.io.images import load_image, read_colour_image, read_photo


def test_an_image_larger_than_any_sensors_is_refused_before_reading(tmp_path):
    path = tmp_path / "strip.png"
    Image.new("L", (2, MOST_SIDE_PX + 1)).save(path)
    with pytest.raises(ValueError, match=naming(MOST_SIDE_PX + 1, MOST_SIDE_PX)):
        load_image(path)
    Image.new("L", (2, MOST_SIDE_PX)).save(path)
    assert load_image(path)[1].shape == (MOST_SIDE_PX, 2)


COLOURS = np.random.default_rng(0).integers(0, 256, (4, 5, 3), np.uint8)
OPAQUE = np.dstack([COLOURS, np.full((4, 5), 255, np.uint8)])
EXIF_TURNED = 6  # stored a quarter turn counterclockwise


def save_picture(path: Path, values: np.ndarray, mode: str | None = None, **options: object) -> Path:
    image = Image.fromarray(values)
    (image if mode is None else image.convert(mode)).save(path, **options)
    return path


def test_photos_are_read_in_every_way_of_storing_their_colours(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = EXIF_TURNED
    flat = np.full((16, 16, 3), (200, 90, 10), np.uint8)
    palette = Image.fromarray(COLOURS).quantize(20)
    palette.save(tmp_path / "palette.png")
    np.save(tmp_path / "alpha.npy", OPAQUE)
    for path in (
        save_picture(tmp_path / "plain.png", COLOURS),
        save_picture(tmp_path / "alpha.tif", OPAQUE),
        save_picture(tmp_path / "turned.png", np.rot90(COLOURS), exif=exif),
        save_picture(tmp_path / "turned.tif", np.rot90(COLOURS), exif=exif),
        tmp_path / "alpha.npy",
    ):
        np.testing.assert_array_equal(read_photo(path), COLOURS, str(path))
    np.testing.assert_array_equal(read_photo(tmp_path / "palette.png"), np.asarray(palette.convert("RGB")))
    assert np.abs(read_photo(save_picture(tmp_path / "a.jpg", flat)).astype(int) - flat).max() <= 3


NO_PHOTOS = {
    "transparent.png": (np.dstack([COLOURS, COLOURS[..., 0]]), None, {}, ["alpha channel", "transparent"]),
    "key.png": (COLOURS, None, {"transparency": tuple(COLOURS[0, 0].tolist())}, ["alpha channel", "transparent"]),
    "grey.png": (COLOURS[..., 0], None, {}, ["8-bit grey"]),
    "grey-alpha.png": (OPAQUE, "LA", {}, ["8-bit grey", "alpha"]),
    "grey16.tif": (COLOURS[..., 0].astype(np.uint16), None, {}, ["16-bit grey"]),
    "binary.png": (COLOURS[..., 0], "1", {}, ["black and white"]),
    "ink.jpg": (COLOURS, "CMYK", {}, ["CMYK"]),
    "pages.tif": (COLOURS, None, {"save_all": True, "append_images": [Image.fromarray(COLOURS)]}, ["pages"]),
}


@pytest.mark.parametrize("name", NO_PHOTOS)
def test_a_picture_that_is_no_photo_of_a_gel_is_named(tmp_path, name):
    values, mode, options, words = NO_PHOTOS[name]
    path = save_picture(tmp_path / name, values, mode, **options)
    for read in (read_photo, read_colour_image):
        with pytest.raises(TouchError, match=naming(name, *words)):
            read(path)


def test_a_contact_shape_is_left_to_its_reader_and_is_no_photo(tmp_path):
    path = save_picture(tmp_path / "depth.png", COLOURS[..., 0].astype(np.uint16))
    assert read_colour_image(path) is None
    with pytest.raises(TouchError, match="16-bit grey"):
        read_photo(path)
