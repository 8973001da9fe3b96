"""The promises of SECURITY.md: no file of any name is read as a pickle, and all files that it names exist."""

import ast
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import load_object, read_touch
from tactile_loc.core.runtime.errors import ObjectError, SensorError, TouchError
from tactile_loc.io.images import read_colour_image
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.plugins.sensors.presets import GelSlim

ROOT = Path(__file__).parents[1]
FOLDERS = ("tactile_loc", "cli", "plugins_contrib", "scripts")
UNSAFE = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
NAMED = re.compile(rf"\b(?:{'|'.join(UNSAFE)})\b|(?:eval|exec|load|load_state_dict_from_url|read_pickle)\s*\(")


def find_unsafe(source: str) -> list[str]:
    """The modules and the calls in a source that can run code from a file."""
    if not NAMED.search(source):  # parsing takes long
        return []
    found, imported = [], set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add((node.module or "").partition(".")[0])
        elif isinstance(node, ast.Call):
            said = ast.unparse(node.func)
            never = said in ("eval", "exec", "builtins.eval", "builtins.exec", "yaml.load", "torch.load")
            never |= said.endswith(("load_state_dict_from_url", "read_pickle"))
            safe = any(k.arg == "allow_pickle" and ast.unparse(k.value) == "False" for k in node.keywords)
            if never or (said in ("np.load", "numpy.load") and not safe):
                found.append(ast.unparse(node))
    return [*sorted(imported & UNSAFE), *found]


# The poses of YCB-Slide are pickled. Their reader admits arrays, texts and numbers only (see test_ycb_slide.py).
ADMITTED = {"ycb_slide.py": ["pickle"]}


def test_no_source_reads_a_pickle():
    paths = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py") if "tests" not in path.parts]
    assert len(paths) > 400
    found = {path: unsafe for path in paths if (unsafe := find_unsafe(path.read_text(encoding="utf-8")))}
    assert {path.name: unsafe for path, unsafe in found.items()} == ADMITTED


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


def read_sensor_with_surface(path: Path) -> object:
    keys = 'camera = "orthographic"\nimage_size_px = [4, 4]\nmm_per_px = 1.0\nmax_depth_mm = 1.0\nsurface = "gel.npy"\n'
    (path.parent / "sensor.toml").write_text(keys)
    return read_sensor_file(path.parent / "sensor.toml")


READERS = {
    "touch.npy": (lambda path: read_touch(path, GelSlim()), TouchError),
    "touch.npz": (lambda path: read_touch(path, GelSlim()), TouchError),
    "touch.png": (lambda path: read_touch(path, GelSlim()), TouchError),
    "photo.npy": (read_colour_image, TouchError),
    "part.stl": (load_object, ObjectError),
    "part.glb": (load_object, ObjectError),
    "part.ply": (load_object, ObjectError),
    "sensor.toml": (read_sensor_file, SensorError),
    "gel.npy": (read_sensor_with_surface, SensorError),
}


@pytest.mark.parametrize(
    ("name", "write"),
    [
        *((name, lambda path, evil: path.write_bytes(pickle.dumps(evil))) for name in READERS),
        *((name, lambda path, evil: np.save(path, np.array([[evil]], object))) for name in ("touch.npy", "gel.npy")),
        ("touch.npz", lambda path, evil: np.savez(path, depth=np.array([[evil]], object))),
    ],
)
def test_a_pickle_or_an_array_of_objects_is_refused_without_running_it(tmp_path, name, write):
    trace, (read, error) = tmp_path / "trace", READERS[name]
    write(tmp_path / name, Evil(trace))
    with pytest.raises(error, match=naming(name)):
        read(tmp_path / name)
    assert not trace.exists()


@pytest.mark.parametrize("path", ["scripts/audit.sh", "scripts/sbom.sh", ".github/workflows/audit.yml"])
def test_files_named_by_the_policy_exist(path):
    policy = (ROOT / "SECURITY.md").read_text()
    assert Path(path).name in policy or f"make {Path(path).stem}" in policy
    assert (ROOT / path).is_file()
