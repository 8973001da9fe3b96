"""Fixtures of the tests of the command line. Most of them save white pictures, for speed."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image


def blank(figure: Figure, path: Path, dpi: int, **_: object) -> None:
    """Write a white picture of a figure's size in its place."""
    width_px, height_px = (int(dpi * inches) for inches in figure.get_size_inches())
    Image.new("L", (width_px, height_px), 255).save(path)


@pytest.fixture
def drawn_pictures() -> None:
    """Draw real pictures, for tests that inspect them."""


@pytest.fixture(autouse=True)
def blank_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Save white pictures in all other tests, because drawing takes longer than locating with a stored model."""
    if "drawn_pictures" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", blank)


@pytest.fixture(scope="session")
def store(store_folder: Path) -> Path:
    """The folder of the session's store."""
    return store_folder
