"""Small plans, a sweep with invented numbers, and a sensor with few pixels."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cli_helpers import FLAT_SENSOR
from report_helpers import make_sweep

from tactile_loc.evaluation.sweep.sweep import Sweep


@pytest.fixture(scope="session")
def flat_sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a sensor with 80 x 80 pixels, for speed."""
    path = tmp_path_factory.mktemp("sensor") / "flat.toml"
    path.write_text(FLAT_SENSOR)
    return path


@pytest.fixture(scope="session")
def tiny(flat_sensor: Path) -> dict[str, Any]:
    """Values of a plan whose combinations take about a second."""
    quick = {"count": 4, "temperature": 0.01, "shape_px": 32}
    return {"sensor": [str(flat_sensor)], "option": {"grid": {"spacing_mm": [8]}}, **quick}


@pytest.fixture(scope="session")
def made_up() -> Callable[..., Sweep]:
    """Make a sweep with invented numbers."""
    return make_sweep
