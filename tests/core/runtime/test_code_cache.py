"""Compiled code is reused until a kernel module changes. Damaged, concurrent and read-only caches are no problem."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import config

from tactile_loc.core.runtime.code_cache import HOUSE, hash_kernels, list_kernels
from tactile_loc.core.runtime.compiled import njit

ROOT = HOUSE.parent

FILES = {
    "things/__init__.py": "",
    "things/pairs.py": """
from typing import NamedTuple

class {pair}(NamedTuple):
    a: float
    b: float
""",
    "things/constants.py": """
from tactile_loc.core.runtime.compiled import njit

OFFSET = {offset}.0

@njit
def add_offset(value):
    return value + OFFSET
""",
    "things/called.py": """
from tactile_loc.core.runtime.compiled import njit
from things.constants import OFFSET

@njit
def helper(pair):
    return pair.a * {factor}.0 + pair.b + OFFSET
""",
    "things/calling.py": """
from tactile_loc.core.runtime.compiled import njit
from things.called import helper

@njit
def kernel(pair):
    return later(pair)

@njit
def later(pair):
    return helper(pair)
""",
    "main.py": """
from things import calling, pairs
value = calling.kernel(pairs.{pair}(3.0, 1.0))
hits = sum(calling.kernel.compiled.stats.cache_hits.values()) if hasattr(calling.kernel.compiled, "stats") else None
print(value, hits)
""",
}


def start(folder, environment=None, **values):
    """Start a kernel that calls a function of another file; its constant and argument type are in two more files."""
    (folder / "things").mkdir(exist_ok=True)
    for name, text in FILES.items():
        path = folder / name
        text = text.format(**{"pair": "Pair", "factor": 2, "offset": 0, **values})
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    # Python's own byte code is not renewed if a source changes within a second and keeps its size
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **(environment or {})}
    command = [sys.executable, "main.py"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=folder, env=environment, **pipes)


def finish(process):
    """Return the kernel's result and its number of cache hits."""
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out.split()


def run(folder, environment=None, **values):
    return finish(start(folder, environment, **values))


def folders(root):
    """Return the folders of compiled code."""
    return {path.parent for path in root.rglob("*.nbi")}


@pytest.mark.slow
def test_compiled_code_is_reused_until_a_source_changes(tmp_path):
    assert run(tmp_path) == ["7.0", "0"]
    assert run(tmp_path) == ["7.0", "1"]
    assert run(tmp_path, factor=4) == ["13.0", "0"]  # an indirectly called function in another file changed
    assert run(tmp_path, factor=4, offset=1) == ["14.0", "0"]  # a constant in a third file changed
    assert len(folders(tmp_path)) == 2  # only two of the three versions are kept
    assert run(tmp_path, factor=4) == ["13.0", "1"]  # the previous version again


@pytest.mark.slow
def test_an_index_with_a_removed_class_is_ignored(tmp_path):
    assert run(tmp_path, pair="Pair") == ["7.0", "0"]
    assert run(tmp_path, pair="Two") == ["7.0", "0"]
    assert run(tmp_path, pair="Two") == ["7.0", "1"]


@pytest.mark.slow
def test_reordered_class_fields_require_compilation(tmp_path):
    assert run(tmp_path) == ["7.0", "0"]
    swapped = "from typing import NamedTuple\nclass Pair(NamedTuple):\n    b: float\n    a: float\n"
    (tmp_path / "things" / "pairs.py").write_text(swapped)
    done = subprocess.run([sys.executable, "main.py"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["5.0", "0"]


@pytest.mark.slow
def test_truncated_compiled_code_is_compiled_again(tmp_path):
    assert run(tmp_path) == ["7.0", "0"]
    for suffix, left in (("nbi", -5), ("nbi", 0), ("nbc", -5)):
        for path in tmp_path.rglob(f"*.{suffix}"):
            path.write_bytes(path.read_bytes()[:left])
        assert run(tmp_path) == ["7.0", "0"]
    assert run(tmp_path) == ["7.0", "1"]


@pytest.mark.slow
def test_several_processes_can_compile_at_the_same_time(tmp_path):
    assert [finish(one)[0] for one in [start(tmp_path) for _ in range(3)]] == ["7.0"] * 3
    assert run(tmp_path) == ["7.0", "1"]


@pytest.mark.slow
def test_the_user_cache_is_used_beside_read_only_sources(tmp_path):
    (source := tmp_path / "source").mkdir()
    (source / "things").mkdir()
    (source / "things" / "__pycache__").touch()  # no folder can be made there, not even by root
    environment = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    assert run(source, environment) == ["7.0", "0"]
    assert run(source, environment) == ["7.0", "1"]
    assert len(folders(tmp_path / "cache")) == 1
    (tmp_path / "file").touch()
    process = start(source, {"XDG_CACHE_HOME": str(tmp_path / "file")})
    assert process.communicate()[1].count("set NUMBA_CACHE_DIR to a folder") == 1, "one warning per folder"
    assert process.returncode == 0


@pytest.mark.slow
def test_numba_settings_are_respected(tmp_path):
    (source := tmp_path / "source").mkdir()
    assert run(source, {"NUMBA_DISABLE_JIT": "1", "NUMBA_CACHE_DIR": str(tmp_path / "chosen")}) == ["7.0", "None"]
    assert not (tmp_path / "chosen").exists()
    assert run(source, {"NUMBA_CACHE_DIR": str(tmp_path / "chosen")}) == ["7.0", "0"]
    assert run(source, {"NUMBA_CACHE_DIR": str(tmp_path / "chosen")}) == ["7.0", "1"]
    assert folders(tmp_path / "chosen")
    assert not folders(source)


def test_the_cache_folder_of_other_functions_is_unchanged():
    before = config.CACHE_DIR
    njit(lambda x: x + 1)
    assert before == config.CACHE_DIR


def find_foreign_names(text: str, kernels: set[str]) -> set[str]:
    """Return the names in compiled functions of a module that come from modules of ours without compiled functions.

    Names that are computed from other names of the module are followed.
    """
    tree = ast.parse(text)
    homes, made, waiting = {}, {}, set()
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tactile_loc"):
            homes |= {alias.asname or alias.name: node.module for alias in node.names}
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            made |= {one.id: node.value for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(one) for one in node.decorator_list):
            waiting |= {one.id for line in node.body for one in ast.walk(line) if isinstance(one, ast.Name)}
    seen: set[str] = set()
    while waiting:
        seen.add(name := waiting.pop())
        if name in made:
            waiting |= {one.id for one in ast.walk(made[name]) if isinstance(one, ast.Name)} - seen
    return {name for name in seen if name in homes and homes[name] not in kernels}


def test_kernel_modules_take_names_from_kernel_modules_alone():
    packages = [HOUSE, *(ROOT / "plugins_contrib").glob("*/tactile_loc_*/")]
    found = {path: package.parent for package in packages for path in list_kernels(package)}
    kernels = {".".join(path.relative_to(parent).with_suffix("").parts) for path, parent in found.items()}
    assert len(kernels) > 10
    foreign = {path.stem: names for path in found if (names := find_foreign_names(path.read_text(), kernels))}
    assert foreign == {}


def test_the_digest_covers_the_package_of_a_file_and_the_house(tmp_path):
    (package := tmp_path / "package" / "inner").mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").touch()
    (kernel := package / "kernel.py").write_text("@njit\ndef f(x): ...\n")
    (plain := package / "plain.py").write_text("# no @njit here\n")
    assert list_kernels(tmp_path / "package") == [kernel]
    assert hash_kernels(kernel) == hash_kernels(plain) != hash_kernels(Path(__file__))
