"""The promises of SECURITY.md: no file of any name is read as a pickle, and all files that it names exist."""

from __future__ import annotations

import ast
import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core import code_cache
from tactile_loc.core.errors import ObjectError, SensorError, TouchError
from tactile_loc.io.images import read_colour_image
from tactile_loc.io.meshes import load_object
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.io.touches import read_touch
from tactile_loc.plugins.sensors.presets import GelSlim

ROOT = Path(__file__).parents[1]
SOURCES = [
    path for folder in ("tactile_loc", "cli", "plugins_contrib", "scripts") for path in (ROOT / folder).rglob("*.py")
]
READS_NAMES_ALONE = "code_cache.py"  # in numba's files; a test below covers it
UNSAFE = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}


def imported(tree: ast.AST) -> set[str]:
    names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {name.partition(".")[0] for name in names}


def calls(tree: ast.AST) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def keywords(call: ast.Call) -> dict[str | None, Any]:
    return {k.arg: k.value.value for k in call.keywords if isinstance(k.value, ast.Constant)}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_source_reads_a_pickle(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    unsafe = imported(tree) & UNSAFE
    assert unsafe == ({"pickle"} if path.name == READS_NAMES_ALONE else set())
    for call in calls(tree):
        said = ast.unparse(call.func)
        assert said not in ("eval", "exec", "builtins.eval", "builtins.exec", "yaml.load")
        assert said != "torch.load"
        assert not said.endswith(("load_state_dict_from_url", "read_pickle"))
        if said in ("np.load", "numpy.load"):
            assert keywords(call).get("allow_pickle") is False, ast.unparse(call)


class Evil:
    """An object that creates a file when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return Path.touch, (self.trace,)


READERS = {
    "touch.npy": (lambda path: read_touch(path, GelSlim()), TouchError),
    "touch.npz": (lambda path: read_touch(path, GelSlim()), TouchError),
    "touch.png": (lambda path: read_touch(path, GelSlim()), TouchError),
    "photo.npy": (read_colour_image, TouchError),
    "part.stl": (load_object, ObjectError),
    "part.glb": (load_object, ObjectError),
    "part.ply": (load_object, ObjectError),
    "sensor.toml": (read_sensor_file, SensorError),
}


def test_reading_names_from_compiled_code_runs_nothing(tmp_path):
    path = tmp_path / "evil.nbi"
    path.write_bytes(3 * pickle.dumps(Evil(tmp_path / "trace")))
    code_cache._delete_unreadable(tmp_path, set())
    assert not (tmp_path / "trace").exists()
    reader = code_cache._NameReader(io.BytesIO(pickle.dumps(Evil(tmp_path / "trace"))))
    reader.load()
    assert reader.names
    assert not (tmp_path / "trace").exists()


@pytest.mark.parametrize("name", READERS)
def test_a_pickle_is_refused_without_running_it(tmp_path, name):
    trace = tmp_path / "trace"
    path = tmp_path / name
    path.write_bytes(pickle.dumps(Evil(trace)))
    read, error = READERS[name]
    with pytest.raises(error, match=naming(name)):
        read(path)
    assert not trace.exists()


@pytest.mark.parametrize("name", ["touch.npy", "touch.npz"])
def test_an_object_array_is_refused_without_running_it(tmp_path, name):
    trace, path = tmp_path / "trace", tmp_path / name
    array = np.array([[Evil(trace)]], dtype=object)
    np.save(path, array) if name.endswith("npy") else np.savez(path, depth=array)
    with pytest.raises(TouchError, match=naming(name)):
        read_touch(path, GelSlim())
    assert not trace.exists()


def test_a_pickled_sensor_surface_is_refused(tmp_path):
    trace = tmp_path / "trace"
    np.save(tmp_path / "gel.npy", np.array([[Evil(trace)]], dtype=object))
    keys = 'camera = "orthographic"\nimage_size_px = [4, 4]\nmm_per_px = 1.0\nmax_depth_mm = 1.0\nsurface = "gel.npy"\n'
    (tmp_path / "sensor.toml").write_text(keys)
    with pytest.raises(SensorError, match=naming("sensor.toml", "gel.npy")):
        read_sensor_file(tmp_path / "sensor.toml")
    assert not trace.exists()


@pytest.mark.parametrize(
    "path", ["scripts/audit.sh", "scripts/sbom.sh", ".github/workflows/audit.yml", "constraints.txt"]
)
def test_files_named_by_the_policy_exist(path):
    assert (
        Path(path).name in (ROOT / "SECURITY.md").read_text()
        or "make " + Path(path).stem in (ROOT / "SECURITY.md").read_text()
    )
    assert (ROOT / path).is_file()
