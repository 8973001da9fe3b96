"""Array files whose headers are wrong: about their size, their inflated size, and their kind."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from PIL import Image

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.runtime.limits import MOST_SIDE_PX
from tactile_loc.io import images
from tactile_loc.io.images import load_image, load_npy, load_npz, measure_image, read_colour_image, read_photo

NUMBERS = np.arange(12.0).reshape(3, 4)


def lying(descr: str, shape: tuple[int, ...], content: bytes = bytes(96)) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue() + content


def zipped(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_written_by_numpy_are_read_unchanged(tmp_path, order):
    np.save(tmp_path / "a.npy", np.asarray(NUMBERS, order=order))
    np.savez_compressed(tmp_path / "a.npz", depth=NUMBERS, unit=np.array("mm"), none=np.zeros((0, 3)))
    np.testing.assert_array_equal(load_npy(tmp_path / "a.npy"), NUMBERS)
    read = load_npz(tmp_path / "a.npz")
    assert (list(read), str(read["unit"]), read["none"].shape) == (["depth", "unit", "none"], "mm", (0, 3))
    np.testing.assert_array_equal(read["depth"], NUMBERS)


LIES = [("<f8", (10**5, 10**6)), ("<f8", (2**62, 8)), ("<f8", (-1, 3)), ("<U0", (10**9,)), ("<f8", (13,)), ("|O", (3,))]


@pytest.mark.parametrize(("descr", "shape"), LIES)
def test_a_header_that_promises_too_much_data_is_refused(tmp_path, descr, shape):
    (tmp_path / "a.npy").write_bytes(lying(descr, shape))
    archive = zipped(tmp_path / "a.npz", depth=lying(descr, shape))
    for load, path in ((load_npy, tmp_path / "a.npy"), (load_npz, archive)):
        with pytest.raises(ValueError, match=r"96|allow_pickle"):
            load(path)


def test_an_array_that_inflates_beyond_the_limit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(images, "MOST_BYTES", 10**6)
    path = zipped(tmp_path / "a.npz", depth=lying("|u1", (2 * 10**6,), bytes(2 * 10**6)))
    assert path.stat().st_size < 10**4
    with pytest.raises(ValueError, match="limit"):
        load_npz(path)


@pytest.mark.parametrize("content", [b"", b"PK", b"PK\x03\x04" + bytes(100), b"\x93NUMPY\x09\x00", b"text"])
def test_a_file_without_arrays_is_refused(tmp_path, content):
    for suffix, load in ((".npy", load_npy), (".npz", load_npz)):
        (tmp_path / f"a{suffix}").write_bytes(content)
        with pytest.raises(ValueError):  # noqa: PT011 - the reason is whatever the file lacks
            load(tmp_path / f"a{suffix}")


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


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
def test_the_shape_of_a_picture_is_that_after_turning_it(tmp_path, suffix):
    exif = Image.Exif()
    exif[0x0112] = EXIF_TURNED
    for options in ({}, {"exif": exif}):
        path = save_picture(tmp_path / f"a.{suffix}", COLOURS, **options)
        assert measure_image(path) == ("RGB", load_image(path)[1].shape[:2])


def test_a_contact_shape_is_left_to_its_reader_and_is_no_photo(tmp_path):
    path = save_picture(tmp_path / "depth.png", COLOURS[..., 0].astype(np.uint16))
    assert read_colour_image(path) is None
    with pytest.raises(TouchError, match="16-bit grey"):
        read_photo(path)
