"""examples/insertion: the video's files, and how MuJoCo draws without a display."""

import os
from types import SimpleNamespace

import headless
import numpy as np
import pytest
from message_helpers import missing

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'tactile-loc[sim]'")

from video import GEL_PX, draw_gel, write_video

from tactile_loc import Localizer

FRAMES = [np.full((60, 80, 3), value, np.uint8) for value in (0, 100, 200)]


def test_a_webm_file_has_all_frames(tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs imageio-ffmpeg")
    write_video(FRAMES, tmp_path / "three.webm")
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "three.webm"))
    assert next(reader)["size"] == (80, 60)
    assert len(list(reader)) == 3


def test_the_picture_of_a_gel_has_its_top_above(store):
    """The image's x axis points up along the gel, so its last columns are at the top of the picture."""
    touch = Localizer.create("pin", sensor="gelsight-mini", store=store).simulate(seed=1)[0]
    assert draw_gel(touch).size == GEL_PX
    dark = np.asarray(draw_gel(None))
    assert (dark == dark[0, 0]).all()
    shown = np.asarray(draw_gel(touch)).astype(int).sum(axis=2)
    pressed = touch.press_depth_m - touch.contact_shape.depth_m
    top = pressed[:, pressed.shape[1] // 2 :].sum() > pressed[:, : pressed.shape[1] // 2].sum()
    brighter = np.abs(shown - dark[0, 0].astype(int).sum())
    assert (brighter[: GEL_PX[1] // 2].sum() > brighter[GEL_PX[1] // 2 :].sum()) == top


@pytest.mark.parametrize(
    ("chosen", "drawing", "backend", "words"),
    [("", False, "disable", []), ("", True, "osmesa", ["OSMesa"]), ("glfw", True, "glfw", [])],
)
def test_mujoco_draws_with_the_users_backend_or_osmesa_without_egl(
    monkeypatch, capsys, chosen, drawing, backend, words
):
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        monkeypatch.setenv(name, chosen)
    if not chosen:
        monkeypatch.delenv("MUJOCO_GL")
    monkeypatch.setattr(headless.subprocess, "run", lambda *a, **k: SimpleNamespace(returncode=1))
    headless.choose_backend(drawing=drawing)
    assert os.environ["MUJOCO_GL"] == backend
    assert os.environ["PYOPENGL_PLATFORM"] == (backend if words else chosen)
    assert not missing(capsys.readouterr().err, *words)
