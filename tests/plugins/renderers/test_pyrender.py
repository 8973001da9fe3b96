"""OpenGL: several contexts in one process, windings, clipping, and machines without EGL."""

import subprocess
import sys
import threading

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.errors import RenderError

pytest.importorskip("pyrender")

from tactile_loc.plugins.renderers.pyrender.renderer import PyrenderRenderer

CODE_IMPORT_ONLY = """
import os, sys
os.environ.pop("PYOPENGL_PLATFORM", None)
import tactile_loc.plugins.renderers.pyrender.renderer as module
module.PyrenderRenderer().close()
assert "PYOPENGL_PLATFORM" not in os.environ
assert not {"pyrender", "OpenGL"} & set(sys.modules), "heavy libraries must load at the first picture"
"""


@pytest.fixture
def pressed(camera):
    """A sphere of 8 mm radius in contact."""
    return make_transform(np.eye(3), [0.001, 0.0, camera.standoff_m + 0.008])[None]


def test_an_import_loads_no_opengl_and_changes_no_environment():
    subprocess.run([sys.executable, "-c", CODE_IMPORT_ONLY], check=True)


def test_a_missing_device_gives_a_one_sentence_error(camera, sphere, pressed, monkeypatch, new_pyrender):
    monkeypatch.setenv("EGL_DEVICE_ID", "99")
    named = naming("(99)", "libegl1", "libgl1-mesa-dri", "`renderer` heightmap", "`renderer` raycast")
    with pytest.raises(RenderError, match=named) as caught:
        new_pyrender().render(sphere, pressed, camera)
    assert "\n" not in str(caught.value)
    monkeypatch.delenv("EGL_DEVICE_ID")
    assert np.isfinite(new_pyrender().render(sphere, pressed, camera)).any(), "a later attempt may succeed"


def test_a_missing_library_gives_a_one_sentence_error(camera, sphere, pressed, monkeypatch):
    monkeypatch.setitem(sys.modules, "tactile_loc.plugins.renderers.pyrender.gl", None)
    with pytest.raises(RenderError, match=naming("libegl1", "libgl1-mesa-dri")):
        PyrenderRenderer().render(sphere, pressed, camera)


def test_the_platform_set_by_the_user_is_kept(camera, sphere, pressed, monkeypatch, new_pyrender):
    monkeypatch.setenv("PYOPENGL_PLATFORM", "abacus")
    with pytest.raises(RenderError, match="abacus"):
        new_pyrender().render(sphere, pressed, camera)


def test_a_failure_during_rendering_is_a_render_error(camera, sphere, pressed, monkeypatch, new_pyrender):
    from OpenGL.error import GLError

    from tactile_loc.plugins.renderers.pyrender import gl as pyrender_gl

    def fail(*_):
        raise GLError(1285)

    monkeypatch.setattr(pyrender_gl.DepthScene, "draw", fail)
    with pytest.raises(RenderError, match=naming("out of memory", "`renderer` heightmap")):
        new_pyrender().render(sphere, pressed, camera)


def test_garbage_collection_of_a_renderer_does_not_affect_another(camera, sphere, pressed, new_pyrender):
    """The garbage collector may close a renderer at the worst moment, in the middle of a picture."""
    drawing, unused = new_pyrender(), new_pyrender()
    expected = drawing.render(sphere, pressed, camera)
    unused.render(sphere, pressed, camera)
    inner = drawing._offscreen._renderer
    render = inner.render

    def interrupted(*words, **named):
        unused.close()
        return render(*words, **named)

    inner.render = interrupted
    np.testing.assert_array_equal(drawing.render(sphere, pressed, camera), expected)
    assert unused._offscreen is None


def test_sizes_and_meshes_may_alternate_and_a_closed_renderer_opens_again(
    camera, sphere, bracket, pressed, new_pyrender
):
    renderer, small = new_pyrender(), camera.resize(45, 32)
    expected = renderer.render(sphere, pressed, camera)
    assert renderer.render(sphere, pressed, small).shape == (1, 32, 45)
    assert (renderer.render(bracket, pressed, camera) != expected).any()
    np.testing.assert_array_equal(renderer.render(sphere, pressed, camera), expected)
    renderer.close()
    renderer.close()
    np.testing.assert_array_equal(renderer.render(sphere, pressed, camera), expected)


def test_another_thread_may_draw(camera, sphere, pressed, new_pyrender):
    renderer, results = new_pyrender(), []
    expected = renderer.render(sphere, pressed, camera)
    thread = threading.Thread(target=lambda: results.append(renderer.render(sphere, pressed, camera)))
    thread.start()
    thread.join()
    np.testing.assert_array_equal(results[0], expected)


@pytest.mark.parametrize("which", ["all", "half", "open"])
def test_the_winding_of_faces_does_not_matter(camera, sphere, pressed, new_pyrender, which):
    """Faces wound inwards hide as much as others: if all are, if some are, or if the surface is open."""
    faces = sphere.faces.copy()
    faces[:: 1 if which == "all" else 2] = faces[:: 1 if which == "all" else 2, ::-1]
    if which == "open":
        faces = faces[sphere.triangles_m[:, :, 2].mean(axis=1) < 0.0]
    expected = new_pyrender().render(sphere, pressed, camera)
    np.testing.assert_array_equal(
        new_pyrender().render(TriangleMesh(sphere.vertices_m, faces), pressed, camera), expected
    )


def test_the_whole_contact_band_is_between_the_clipping_planes(camera, quad, new_pyrender):
    for share, seen in ((0.0, True), (1.0, True), (1.1, False)):
        z = camera.standoff_m + share * camera.max_depth_m
        depth = new_pyrender().render(quad, make_transform(np.eye(3), [0, 0, z])[None], camera)
        assert np.isfinite(depth).all() if seen else np.isinf(depth).all()
