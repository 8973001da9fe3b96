"""Small plans, a sweep with invented numbers, and a sensor with few pixels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from tactile_loc.evaluation.jobs import JobOutcome
from tactile_loc.evaluation.sweep.combination import Combination, combine
from tactile_loc.evaluation.sweep.plan import Plan
from tactile_loc.evaluation.sweep.sweep import MEASURED, Sweep

SENSOR = 'camera = "orthographic"\nimage_size_px = [80, 80]\nmax_depth_mm = 2.0\nmm_per_px = 0.35\n'

Measure = Callable[[Combination], Mapping[str, float] | str]


@pytest.fixture(scope="session")
def flat_sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a sensor with 80 x 80 pixels, for speed."""
    path = tmp_path_factory.mktemp("sensor") / "flat.toml"
    path.write_text(SENSOR)
    return path


@pytest.fixture(scope="session")
def tiny(flat_sensor: Path) -> dict[str, Any]:
    """Values of a plan whose combinations take about a second."""
    return {
        "sensor": [str(flat_sensor)], "option": {"grid": {"spacing_mm": [8]}}, "count": 4, "temperature": 0.01,
        "shape_px": 32,
    }  # fmt: skip


@pytest.fixture(scope="session")
def made_up() -> Callable[[dict[str, Any], Measure], Sweep]:
    """Make a sweep of a plan's values; `measure` gives some columns of each combination, or the text of its error."""

    def make(values: dict[str, Any], measure: Measure) -> Sweep:
        plan = Plan.from_values(values)
        combinations, _ = combine(plan)
        outcomes = {}
        for one in combinations:
            found = measure(one)
            if isinstance(found, str):
                outcomes[one.key] = JobOutcome(one.key, None, error=found)
            else:
                zeros = dict.fromkeys(MEASURED, 0.0)
                outcomes[one.key] = JobOutcome(one.key, {"grid_poses": 7, **zeros, **found}, (f"grid {one.key}",))
        return Sweep(plan, combinations, outcomes, len(combinations))

    return make
