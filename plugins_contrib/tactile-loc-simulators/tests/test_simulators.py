"""Arrays of simulators as touches: drawn by MuJoCo and Taxim, and made by hand where the simulator is not run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tactile_loc import Localizer, TactileLocError, Touch

from tactile_loc_simulators import CONVENTIONS, OPENGL, make_camera, make_touch

FOVY, STANDOFF_M = 0.8, 0.025
CAMERA = make_camera(FOVY, 160, 120, STANDOFF_M, 0.002)
README = Path(__file__).parents[1] / "README.md"


@pytest.fixture(scope="module")
def touched() -> tuple[Localizer, Touch]:
    localizer = Localizer.create("hook", sensor="gelsight-mini")
    return localizer, localizer.simulate(1, seed=1)[0]


def contact_iou(ours: Touch, theirs: Touch) -> float:
    a, b = ours.contact_shape.contact, theirs.contact_shape.contact
    return float((a & b).sum() / (a | b).sum())


def test_mujoco_draws_the_same_touch(touched, tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, "MUJOCO_GL", os.environ.get("MUJOCO_GL", "egl"))
    try:
        import mujoco
    except (ImportError, AttributeError) as error:  # an older PyOpenGL lacks a part of EGL
        pytest.skip(f"mujoco is not installed, or cannot draw here: {error}")
    trimesh = pytest.importorskip("trimesh")
    localizer, touch = touched
    scene = localizer.scene
    mesh = scene.object.mesh
    trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False).export(tmp_path / "part.stl")
    T_sensor_object = touch.T_sensor_object.copy()
    T_sensor_object[2, 3] += STANDOFF_M - touch.geometry.surface_m
    T = OPENGL @ T_sensor_object
    rotation = " ".join(map(str, [*T[:3, 0], *T[:3, 1]]))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler meshdir="{tmp_path}"/><visual><map znear="0.001" zfar="10"/></visual>'
        '<statistic extent="1"/><asset><mesh name="part" file="part.stl" inertia="shell"/></asset><worldbody>'
        f'<camera name="gel" fovy="{np.degrees(FOVY)}"/>'
        f'<geom type="mesh" mesh="part" pos="{T[0, 3]} {T[1, 3]} {T[2, 3]}" xyaxes="{rotation}"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    try:
        renderer = mujoco.Renderer(model, 120, 160)
    except (ImportError, AttributeError, RuntimeError, mujoco.FatalError) as error:
        pytest.skip(f"mujoco cannot draw here: {error}")
    with renderer:
        renderer.enable_depth_rendering()
        renderer.update_scene(data, "gel")
        seen = make_touch("mujoco", renderer.render(), CAMERA)
    pressed = CAMERA.press(touch.press_depth_m)
    ours = scene.renderer.render(scene.object.mesh, T_sensor_object[None], pressed)[0]
    expected = make_touch("mujoco", np.where(np.isfinite(ours), ours, 1.0), CAMERA)
    assert contact_iou(seen, expected) > 0.9
    assert seen.press_depth_m == pytest.approx(expected.press_depth_m, abs=5e-5)
    assert seen.press_depth_m == pytest.approx(touch.press_depth_m, abs=5e-5)


def test_taxim_shows_contact_where_the_touch_has_it(touched):
    pytest.importorskip("jax", reason="jax is not installed")
    taxim = pytest.importorskip("taxim", reason="taxim is not installed")
    _, touch = touched
    shape = touch.contact_shape
    heights_mm = (1e3 * (shape.depth_m - shape.press_depth_m)).astype(np.float32)
    seen = make_touch("taxim", heights_mm, touch.geometry)
    np.testing.assert_allclose(seen.contact_shape.depth_m, shape.depth_m, atol=1e-6)
    simulator = taxim.Taxim(taxim.CALIB_GELSIGHT_MINI, backend="jax")
    images = [np.asarray(simulator.render(one, with_shadow=False)) for one in (heights_mm, 0 * heights_mm + 1)]
    changed = np.abs(images[0] - images[1]).mean(axis=-1)
    inside = seen.contact_shape.contact
    assert changed[inside].mean() > 3 * changed[~inside].mean()


@pytest.mark.parametrize("simulator", ["isaac-lab", "tacsl", "mujoco"])
def test_distances_are_compared_with_the_untouched_gel(simulator):
    untouched = np.full((1, 120, 160, 1), 0.03)
    depth_m = untouched.copy()
    depth_m[0, 40:80, 60:90] -= 0.0015
    touch = make_touch(simulator, depth_m[0], CAMERA, untouched[0], name="left")
    assert touch.press_depth_m == pytest.approx(0.0015)
    assert (touch.name, touch.contact_shape.contact.sum()) == ("left", 40 * 30)
    with pytest.raises(TactileLocError):
        make_touch(simulator, untouched[0], CAMERA, untouched[0])


def test_tacto_gives_indentations():
    indentation_m = np.zeros((120, 160))
    indentation_m[40:80, 60:90] = 0.001
    assert make_touch("tacto", indentation_m, CAMERA).press_depth_m == pytest.approx(0.001)


def test_a_camera_sees_its_angle():
    x0, x1, y0, y1 = CAMERA.view
    assert (y1 - y0) / 2 == pytest.approx(STANDOFF_M * np.tan(FOVY / 2))
    assert (x1 - x0) / (y1 - y0) == pytest.approx(160 / 120)


def test_an_unknown_simulator_is_refused():
    with pytest.raises(TactileLocError, match="taxim"):
        make_touch("taxin", np.zeros((120, 160)), CAMERA)


@pytest.mark.skipif(not README.is_file(), reason="only the package is installed, without its README")
def test_the_readme_lists_the_conventions_and_its_example_runs(tmp_path):
    page = README.read_text()
    rows = dict(re.findall(r"^\| `([\w-]+)` \|.*\| ([\w-]+),[^|]*\|$", page, re.MULTILINE))
    assert {name: said == "yes" for name, said in rows.items()} == {name: c.tested for name, c in CONVENTIONS.items()}
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    command, paths = [sys.executable, "-c", example], {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(command, cwd=tmp_path, env=paths, capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(0.001)
