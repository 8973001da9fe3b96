"""The benchmark of the page drags the finger along the object, and measures updates of the real view."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from tactile_loc import RunConfig, StageStore, load_object

from tactile_loc_app.session import Session
from tactile_loc_app.shared_localizers import SharedLocalizers

with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    app = importlib.import_module("app")


@pytest.fixture
def session(tmp_path) -> Session:
    localizers = SharedLocalizers(tmp_path, StageStore(tmp_path / "store"))
    return Session(localizers, RunConfig.from_dict({"object": {"path": "hook"}, "sensor": "gelsight-mini"}))


def test_the_finger_is_dragged_along_the_longest_side(session):
    above, corners_m = app.place_above(session.object, session.scene), session.object.mesh.corners_m
    poses, presses_m = zip(*app.drag(session.object, above, 200, 1e-3), strict=True)
    places_m = np.array(poses)[:, :2, 3]
    along = int(np.argmax(session.object.mesh.extents_m[:2]))
    assert np.ptp(places_m[:, along]) == pytest.approx(app.MARGIN * session.object.mesh.extents_m[along], rel=1e-3)
    assert (places_m >= corners_m[:, :2].min(axis=0)).all()
    assert (places_m <= corners_m[:, :2].max(axis=0)).all()
    assert 0 < min(presses_m) < max(presses_m) <= 1e-3


def test_updates_are_measured_and_misses_do_not_count(session):
    viser = pytest.importorskip("viser", reason="viser is not installed")
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    try:
        row = app.measure(session, server, 20)
    finally:
        server.stop()
    assert row.updates == 20
    assert 0 < len(row.seconds) <= 20
    assert (row.seconds > 0).all()
    median = float(row.format("hook").split(" | ")[3])
    assert median == pytest.approx(1e3 * np.median(row.seconds), abs=0.051)


@pytest.mark.slow
def test_the_large_mesh_has_the_same_surface(tmp_path):
    small, large = load_object("hook").mesh, load_object(app.write_large("hook", tmp_path), units="mm").mesh
    assert len(large.faces) >= app.LARGE
    assert np.allclose(large.extents_m, small.extents_m, atol=1e-8)
    assert large.face_areas.sum() == pytest.approx(small.face_areas.sum(), rel=1e-5)
