"""The promises of SECURITY.md: no file of any name is read as a pickle, and all files that it names exist."""

from __future__ import annotations

import ast
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ObjectError, SensorError, TouchError
from tactile_loc.io.images import read_colour_image
from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.io.touches import read_touch
from tactile_loc.plugins.sensors.presets import GelSlim

ROOT = Path(__file__).parents[1]
FOLDERS = ("tactile_loc", "cli", "plugins_contrib", "scripts")
UNSAFE = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
NAMED = re.compile(rf"\b(?:{'|'.join(UNSAFE)})\b|(?:eval|exec|load|load_state_dict_from_url|read_pickle)\s*\(")


def imported(tree: ast.AST) -> set[str]:
    names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {name.partition(".")[0] for name in names}


def calls(tree: ast.AST) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def keywords(call: ast.Call) -> dict[str | None, Any]:
    return {k.arg: k.value.value for k in call.keywords if isinstance(k.value, ast.Constant)}


def find_unsafe(source: str) -> list[str]:
    """The modules and the calls in a source that can run code from a file."""
    if not NAMED.search(source):  # parsing takes long
        return []
    tree, found = ast.parse(source), []
    for call in calls(tree):
        said = ast.unparse(call.func)
        never = said in ("eval", "exec", "builtins.eval", "builtins.exec", "yaml.load", "torch.load")
        never |= said.endswith(("load_state_dict_from_url", "read_pickle"))
        if never or (said in ("np.load", "numpy.load") and keywords(call).get("allow_pickle") is not False):
            found.append(ast.unparse(call))
    return [*sorted(imported(tree) & UNSAFE), *found]


def test_no_source_reads_a_pickle():
    paths = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    assert len(paths) > 400
    found = {path: unsafe for path in paths if (unsafe := find_unsafe(path.read_text(encoding="utf-8")))}
    assert {path.name: unsafe for path, unsafe in found.items()} == {}


@pytest.mark.parametrize(
    ("source", "unsafe"),
    [
        ("from joblib import dump", ["joblib"]),
        ("def f():\n    import pickle as p", ["pickle"]),
        ("numpy.load(path)", ["numpy.load(path)"]),
        ("np.load(path, allow_pickle=True)", ["np.load(path, allow_pickle=True)"]),
        ("np.load(path, allow_pickle=False)", []),
        ("pd.read_pickle(path)", ["pd.read_pickle(path)"]),
        ("eval(text)", ["eval(text)"]),
    ],
)
def test_unsafe_sources_are_found(source, unsafe):
    assert find_unsafe(source) == unsafe


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
