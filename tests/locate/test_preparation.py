"""After its preparation, a localizer neither compiles nor opens files: one or several touches, sensors, and tracks."""

import os
import subprocess
import sys
from contextlib import contextmanager

import pytest

from tactile_loc.core.runtime.progress import Progress
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.preparation import list_presses

SMALL = {"grid": {"name": "whole", "directions": 300, "turns": 24}}
MINI = {"name": "gelsight-mini", "image_size_px": [100, 75]}
SCRIPT = """
import sys
from dataclasses import replace

import numpy as np
from numba.core import event

from tactile_loc import Localizer, Tracker

prepared = sys.argv[2] == "prepared"
slim = {"name": "gelslim", "image_size_px": [100, 100]}
grid = {"name": "whole", "directions": 300, "turns": 24}
localizer = Localizer.create("pin", store=sys.argv[1], sensor=slim, grid=grid)
mini = localizer.for_sensor({"name": "gelsight-mini", "image_size_px": [100, 75]})
if prepared:
    localizer.prepare()
taken = [touch for pair in zip(localizer.simulate(3, seed=5), mini.simulate(3, seed=6)) for touch in pair]
touches = [replace(touch, T_base_sensor=np.linalg.inv(touch.T_sensor_object)) for touch in taken]
opened = []
sys.addaudithook(lambda name, given: opened.append(given[0]) if name in ("open", "import") else None)
with event.install_recorder("numba:compile") as compiled:
    for touch in touches:
        str(localizer.locate(touch))
    localizer.locate([None, None])
    for count in range(2, 7):
        localizer.find_most_probable_pose(touches[:count])
    localizer.locate([*touches[:2], replace(touches[2], T_base_sensor=touches[4].T_base_sensor)])
    tracker = Tracker(localizer)
    for k in range(40):
        pair = touches[2 * (k // 10 % 2) :][:2]  # the object seems to move
        tracker.update(0.02 * k, [pair[0] if k % 5 else None, pair[1]])
print(len(compiled.buffer), len(opened), opened[:5])
"""


@pytest.mark.slow
@pytest.mark.parametrize("prepared", [True, False])
def test_no_call_compiles_or_opens_a_file_after_the_preparation(tmp_path, prepared):
    words = [sys.executable, "-c", SCRIPT, str(tmp_path / "store"), "prepared" if prepared else "not"]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
    said = subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout.split(maxsplit=2)
    if prepared:
        assert said[:2] == ["0", "0"], said
    else:
        assert int(said[1]) > 0, "the test does not notice opened files"


def test_the_preparation_shows_its_progress_and_keeps_the_lightest_presses(store, monkeypatch):
    steps = {}

    class Counted(Progress):
        @contextmanager
        def task(self, description, total):
            done = steps[description] = [0, total]

            def advance(steps):
                done[0] += steps

            yield advance

    localizer = Localizer.create("pin", store=store, sensor=MINI, progress=Counted(), prepared=True, **SMALL)
    presses = list_presses(localizer.scene.geometry.max_depth_m, trained=False)
    assert steps["prepare: presses"] == [len(presses)] * 2
    done, total = steps["prepare: examples"]
    assert done == total > 3
    lightest_m = min(presses)
    banks = localizer.source.place_search._banks
    monkeypatch.setattr(banks, "bank", None)  # no bank can be made any more
    assert banks.matcher(lightest_m) is not None
