"""Rerun files, read back by Rerun itself."""

import os
import sys
from dataclasses import replace

import numpy as np
import pytest
from message_helpers import missing, naming
from rerun_helpers import read

from tactile_loc import LocatedFrame, Verdict
from tactile_loc.core.runtime.errors import MissingLibraryError, OutputError
from tactile_loc.plugin.helpers import make_transform, rotation_about
from tactile_loc.view.drawn_scene import DEVIATIONS, DrawnScene, DrawnSensor
from tactile_loc.view.rerun_log import RerunLog, require_rerun, write_localization

T = make_transform(rotation_about([1, 2, 3], 0.8), [0.001, -0.002, 0.03])
C = np.diag(np.square([1e-4, 3e-4, 2e-4, 0.01, 0.02, 0.03]))


def located() -> LocatedFrame:
    return LocatedFrame(Verdict.CERTAIN, np.stack([T, np.eye(4)]), np.array([0.75, 0.2]), C, 0.9)


@pytest.fixture
def rerun():
    return pytest.importorskip("rerun", reason="rerun is not installed")


def test_rerun_reads_the_logged_entries(rerun, localizer, tmp_path):
    touch = replace(localizer.simulate(1, seed=0)[0], T_base_sensor=make_transform(np.eye(3), [0.4, 0, 0.1]))
    photo = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    with RerunLog(tmp_path / "a.rrd", localizer.scene) as log:
        sensor = DrawnSensor(touch.geometry, touch=touch, image=photo)
        log.add(3, 0.0, DrawnScene.of_frame(localizer.scene, located(), sensor))
        log.add(5, 0.5, DrawnScene.of_frame(localizer.scene, None, text="no contact"))
    found = read(tmp_path / "a.rrd")
    poses = found["base/sensor/object"]
    np.testing.assert_allclose(poses["Transform3D:translation"][0][0], T[:3, 3], atol=1e-7)
    np.testing.assert_allclose(np.reshape(poses["Transform3D:mat3x3"][0][0], (3, 3)), T[:3, :3].T, atol=1e-6)
    np.testing.assert_allclose(found["base/sensor"]["Transform3D:translation"][0][0], [0.4, 0, 0.1], atol=1e-7)
    (half,) = found["base/sensor/uncertainty"]["Ellipsoids3D:half_sizes"][0]
    np.testing.assert_allclose(sorted(half), DEVIATIONS * np.array([1e-4, 2e-4, 3e-4]), rtol=1e-5)
    np.testing.assert_allclose(found["base/sensor/uncertainty"]["covariance"][0], C.ravel())
    assert found["base/sensor/hypotheses"]["probability"][0] == [0.75, 0.2]
    turns = np.reshape(found["base/sensor/hypotheses"]["InstancePoses3D:mat3x3"][0], (2, 3, 3))
    np.testing.assert_allclose(turns, [T[:3, :3].T, np.eye(3)], atol=1e-6)
    assert bytes(found["image"]["Image:buffer"][0][0]) == photo.tobytes()
    depth = np.frombuffer(bytes(found["contact_shape"]["DepthImage:buffer"][0][0]), np.float32)
    np.testing.assert_array_equal(depth, touch.contact_shape.depth_m.ravel())
    assert len(found["base/sensor/object/surface"]["Mesh3D:vertex_positions"][0]) == len(
        localizer.object.mesh.vertices_m
    )
    assert [c[0] & 255 for c in found["base/sensor/object/surface"]["Mesh3D:albedo_factor"]] == [0, 255, 0]
    texts = [t[0] for t in found["pose"]["TextDocument:text"]]
    assert not missing(texts[0], "certain", "75 %", "1.0, -2.0, 30.0 mm", "45.8°", "(0.27, 0.53, 0.80)")
    assert not missing(texts[0], "0.10, 0.30, 0.20 mm", "0.6, 1.1, 1.7°")
    assert texts[1] == "no contact"


def test_a_result_logs_its_posterior(rerun, localizer, localization, tmp_path):
    found = read(write_localization(tmp_path / "a.rrd", localization, localizer.scene))
    poses = np.reshape(found["base/sensor/posterior"]["T_sensor_object"][0], (-1, 4, 4))
    shares = np.array(found["base/sensor/posterior"]["probability"][0])
    assert poses.shape == (len(shares), 4, 4)
    best = localization.posterior.top(1)[0]
    np.testing.assert_allclose(poses[0], localization.posterior.grid.T_sensor_object[best], atol=1e-12)
    assert shares[0] == pytest.approx(np.exp(localization.posterior.log_p[best]))
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


def test_an_unusable_rerun_file_is_refused_before_the_run(rerun, tmp_path, monkeypatch):
    with pytest.raises(OutputError, match=naming(".rrd", "a.txt", "`rerun`")):
        require_rerun(tmp_path / "a.txt")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=naming(tmp_path / "file", "`out`")):
        require_rerun(tmp_path / "file" / "a.rrd")
    with pytest.raises(OutputError, match=naming(r"\xe4.rrd", "Unicode")):
        require_rerun(tmp_path / os.fsdecode(b"\xe4.rrd"))
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingLibraryError, match=naming("pip install 'tactile-loc[view]'")):
        require_rerun(tmp_path / "a.rrd")


def test_a_full_disk_gives_a_one_sentence_error(rerun, localizer, tmp_path, monkeypatch):
    def full(*_: object, **__: object) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    with RerunLog(tmp_path / "a.rrd", localizer.scene) as log, monkeypatch.context() as patch:
        patch.setattr(log._stream, "flush", full)
        with pytest.raises(OutputError, match=naming("a.rrd", "`rerun`")):
            log.add(0, 0.0, DrawnScene.of_frame(localizer.scene, None))
