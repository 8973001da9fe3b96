"""The TOML files in docs/files.md can be read."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import is_rigid
from tactile_loc.io.prior_files import read_prior
from tactile_loc.io.touch_lists import read_touch_list
from tactile_loc.io.touches import write_touch
from tactile_loc.locate.localizer import Localizer

PAGE = Path(__file__).parents[1] / "docs" / "files.md"


def block(first: str) -> str:
    """The TOML block of the page that begins with `first`."""
    (found,) = [b for b in re.findall(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL) if b.startswith(first)]
    return found


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    return Localizer.create("pin", store=store, grid={"name": "face", "spacing_mm": 8})


def test_the_list_of_touches_can_be_read(localizer, tmp_path):
    write_touch(tmp_path / "first.npz", localizer.simulate(1)[0])
    (tmp_path / "second.png").touch()
    (tmp_path / "my_sensor").mkdir()
    (tmp_path / "my_sensor" / "calibration.json").write_text("{}")
    (tmp_path / "touches.toml").write_text(block("[[touch]]"))
    first, second = read_touch_list(tmp_path / "touches.toml")
    assert (first.path.name, first.sensor) == ("first.npz", "gelslim")
    assert Path(str(second.sensor)).name == "my_sensor"
    assert is_rigid(np.stack([np.asarray(t.T_base_sensor) for t in (first, second)]))
    assert np.asarray(first.T_base_sensor)[:3, 3] == pytest.approx([0.4, 0.0, 0.12])


def test_the_prior_can_be_read(localizer, tmp_path):
    (tmp_path / "prior.toml").write_text(block('kind = "gaussian"'))
    prior = read_prior(tmp_path / "prior.toml", localizer.object)
    assert prior.frame == "base"
    weights = prior.view_from(np.eye(4))(localizer.model.grid.T_sensor_object)
    assert np.isfinite(weights).all()
