"""Hashes of code: what a component's hash covers, and what it does not depend on."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from message_helpers import naming

import tactile_loc
from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.slots.code import hash_code, hash_component
from tactile_loc.slots.registry import registry

REFINER = """
from tactile_loc.plugin import RefinedPose, Refiner
{imports}

class Still(Refiner):
    def refine(self, touch, candidate, scene):
        return RefinedPose(candidate.T_sensor_object, 1.0, True, 0)
"""
HASHES = """
import json, sys
import tactile_loc
from tactile_loc.slots.registry import registry
found = {name: registry().load(*name.split()) for name in sys.argv[1:]}
print(json.dumps([tactile_loc.__file__, {name: kind().describe()["code"] for name, kind in found.items()}]))
"""
BUILT_IN = ("refiner joint", "refiner filterreg", "grid face", "matcher dense", "sensor gelslim")


def hash_anew(name: str) -> str:
    """The hash of the code with this name that another process would find; a colon precedes a component's class."""
    module, _, kind = name.partition(":")
    hash_code.cache_clear()
    hash_component.cache_clear()
    if not kind:
        return hash_code(name)
    for loaded in {name for name in sys.modules if name.startswith("keyed_")}:
        del sys.modules[loaded]
    importlib.invalidate_caches()
    return hash_component(getattr(importlib.import_module(module), kind))


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of a user's modules, whose names begin with keyed_."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield tmp_path
    for loaded in {name for name in sys.modules if name.startswith("keyed_")}:
        del sys.modules[loaded]


@pytest.fixture
def package(site: Path) -> Path:
    """The folder of a package with a module in a subpackage."""
    folder = site / "keyed_package"
    (folder / "inner").mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "inner" / "deep.py").write_text("A = 1\n")
    return folder


def test_any_change_of_a_package_s_files_changes_its_hash(package):
    seen = [hash_anew("keyed_package")]
    for name, text in (
        ("inner/deep.py", "A = 2\n"),
        ("inner/more.py", ""),
        ("table.json", "[1]"),
        ("table.json", "[2]"),
    ):
        (package / name).write_text(text)
        seen.append(hash_anew("keyed_package"))
    (package / "inner" / "more.py").rename(package / "more.py")
    seen.append(hash_anew("keyed_package"))
    assert len({*seen}) == 6
    (package / "__pycache__").mkdir(exist_ok=True)
    (package / "__pycache__" / "deep.cpython-311.pyc").write_bytes(b"compiled")
    assert hash_anew("keyed_package") == seen[-1]


def test_a_module_outside_of_packages_is_hashed_alone(site):
    alone = site / "keyed_module.py"
    alone.write_text("A = 1\n")
    before = hash_anew("keyed_module")
    (site / "keyed_other.py").touch()
    assert hash_anew("keyed_module") == before
    alone.write_text("A = 2\n")
    assert hash_code("keyed_module") == before, "the imported code has not changed"
    assert hash_anew("keyed_module") != before


@pytest.mark.parametrize("name", ["no_such_module_anywhere", "sys"])
def test_code_that_is_not_in_files_is_refused(name):
    with pytest.raises(StoreError, match=naming(name)):
        hash_code(name)


@pytest.mark.parametrize(
    "imports",
    [
        "from keyed_kernel import A",
        "import keyed_kernel",
        "import math, keyed_kernel as kernel  # (the numbers",
        "import math; from keyed_kernel import (  # the numbers :)\n    A,\n)",
        "from keyed_between import B",
        "def late():\n    from \\\n        keyed_kernel import A",
    ],
)
def test_a_module_s_component_changes_with_what_the_module_imports(site, imports):
    main, kernel = site / "keyed_main.py", site / "keyed_kernel.py"
    main.write_text(REFINER.format(imports=imports))
    (site / "keyed_between.py").write_text("from keyed_kernel import A\nB = A\n")
    kernel.write_text("A = 1\n")
    first = hash_anew("keyed_main:Still")
    kernel.write_text("A = 2\n")
    assert hash_anew("keyed_main:Still") != first


def test_a_module_s_component_changes_with_the_module_and_not_with_unrelated_modules(site):
    (main := site / "keyed_main.py").write_text(REFINER.format(imports=""))
    first = hash_anew("keyed_main:Still")
    (site / "keyed_other.py").write_text("C = 1\n")
    assert hash_anew("keyed_main:Still") == first
    main.write_text(main.read_text().replace("1.0", "2.0"))
    assert hash_anew("keyed_main:Still") != first


def test_a_package_s_component_changes_with_all_files_of_its_package(package):
    (package / "main.py").write_text(REFINER.format(imports="from . import inner"))
    first = hash_anew("keyed_package.main:Still")
    (package / "inner" / "deep.py").write_text("A = 2\n")
    second = hash_anew("keyed_package.main:Still")
    (package / "weights.bin").write_bytes(b"\0\r\n")
    assert len({first, second, hash_anew("keyed_package.main:Still")}) == 3


def test_modules_of_one_distribution_belong_together_in_a_folder_of_many_distributions(site, monkeypatch):
    monkeypatch.setattr("tactile_loc.slots.code._list_shared_folders", lambda: {site})
    info = site / "keyed-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: keyed\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tactile_loc]\nkeyed = keyed_main\n")
    (info / "RECORD").write_text("keyed_main.py,,\nkeyed_kernel.py,,\n")
    (site / "keyed_main.py").write_text(REFINER.format(imports="import keyed_kernel, keyed_stranger"))
    (site / "keyed_kernel.py").write_text("A = 1\n")
    (site / "keyed_stranger.py").write_text("A = 1\n")
    first = hash_anew("keyed_main:Still")
    (site / "keyed_stranger.py").write_text("A = 2\n")
    assert hash_anew("keyed_main:Still") == first
    (site / "keyed_kernel.py").write_text("A = 2\n")
    assert hash_anew("keyed_main:Still") != first


def test_a_component_changes_with_its_base_class(site):
    (site / "keyed_base.py").write_text(REFINER.format(imports=""))
    (site / "keyed_heir.py").write_text(
        "import importlib\nStill = importlib.import_module('keyed_base').Still\n\n\nclass Heir(Still): pass\n"
    )
    first = hash_anew("keyed_heir:Heir")
    (site / "keyed_base.py").write_text(REFINER.format(imports="import math"))
    assert hash_anew("keyed_heir:Heir") != first


def test_a_component_depends_on_the_numerical_modules_that_it_imports(site):
    main = site / "keyed_main.py"
    main.write_text(REFINER.format(imports=""))
    alone = hash_anew("keyed_main:Still")
    main.write_text(REFINER.format(imports="from tactile_loc.plugin.helpers import JointRegistration"))
    assert hash_anew("keyed_main:Still") != alone


def test_a_class_without_a_file_is_hashed_by_its_source_or_differs_in_each_process():
    program = REFINER.format(imports="") + "\nprint(Still().describe()['code'])"
    said = [subprocess.check_output([sys.executable, "-c", program], text=True) for _ in range(2)]
    assert said[0] != said[1]


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory) -> Callable[..., dict[str, str]]:
    """Hash built-in components of a copy of tactile-loc, in which the contents of some modules are changed."""
    folder = tmp_path_factory.mktemp("elsewhere")
    copy = folder / "tactile_loc"
    shutil.copytree(Path(tactile_loc.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    command, plain = [sys.executable, "-c", HASHES, *BUILT_IN], {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}

    def run(change: Callable[[bytes], bytes], *places: str) -> dict[str, str]:
        before = {path: path.read_bytes() for place in places for path in copy.glob(place)}
        for path, content in before.items():
            path.write_bytes(change(content))
        file, found = json.loads(subprocess.check_output(command, cwd=folder, env=plain, text=True))
        for path, content in before.items():
            path.write_bytes(content)
        assert Path(file).parent == copy
        return dict(found)

    return run


@pytest.fixture(scope="module")
def here() -> dict[str, str]:
    return {name: registry().load(*name.split())().describe()["code"] for name in BUILT_IN}


def test_the_hash_does_not_depend_on_the_folder_or_on_line_endings(elsewhere, here):
    assert elsewhere(lambda content: content.replace(b"\n", b"\r\n"), "**/*.py") == here


@pytest.mark.parametrize(
    ("module", "changed"),
    [
        ("plugins/refiners/filterreg/kernels", {"refiner filterreg"}),
        ("plugins/refiners/joint", {"refiner joint"}),
        ("bases/exact_matcher", {"matcher dense"}),
        ("slots/refiner", {"refiner joint", "refiner filterreg"}),
        ("core/geometry/rigid", set(BUILT_IN)),
    ],
)
def test_a_built_in_component_changes_with_what_it_imports(elsewhere, here, module, changed):
    found = elsewhere(lambda content: content + b"\nADDED = 1\n", f"{module}.py")
    assert {name for name in BUILT_IN if found[name] != here[name]} == changed


def test_a_built_in_component_does_not_change_with_other_modules(elsewhere, here):
    others = (
        "locate/**/*",
        "evaluation/**/*",
        "core/runtime/*",
        "plugins/refiners/icp",
        "plugins/*/__init__",
        "plugin",
    )
    assert elsewhere(lambda content: content + b"\nADDED = 1\n", *(f"{name}.py" for name in others)) == here
