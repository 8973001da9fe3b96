"""The installation: pinned dependencies, entry points, and the files in the wheel."""

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from tactile_loc_cli import ANNEXES

from tactile_loc.plugins import BUILT_IN

ROOT = Path(__file__).parents[1]
SCRIPTS = ROOT / "scripts"
PROJECT = "tactile-loc"
MAKEFILE = (ROOT / "Makefile").read_text()
MACHINE_SPECIFIC = re.compile(r"/(home|work|opt|root|Users|mnt|tmp)/|file:|https?://\S*/simple|index-url|find-links")


def constraints() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line.split("==") for line in lines if line and not line.startswith("#")]
    return dict(pins)


def requirements(name: str, extras: frozenset[str]) -> list[Requirement]:
    """The requirements of an installed distribution that apply to this environment, with the given extras."""
    parsed = [Requirement(text) for text in metadata.requires(name) or []]
    environments = [{"extra": extra} for extra in extras or {""}]
    return [r for r in parsed if r.marker is None or any(r.marker.evaluate(e) for e in environments)]


def installed_closure(root: str, extras: frozenset[str]) -> dict[str, str]:
    """The name and version of every installed direct or indirect dependency of `root`."""
    found: dict[str, str] = {}
    seen: set[tuple[str, frozenset[str]]] = set()
    queue = [(root, extras)]
    while queue:
        name, wanted = queue.pop()
        if (name, wanted) in seen:
            continue
        seen.add((name, wanted))
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # a development tool that is not installed here
            continue
        queue += [(canonicalize_name(r.name), frozenset(r.extras)) for r in requirements(name, wanted)]
    del found[root]
    return found


def test_constraints_pin_every_installed_dependency():
    pytest.importorskip("open3d", reason="the extras are not installed")
    closure = installed_closure(PROJECT, frozenset({"dev", "mutate"}))
    installed = {name: Version(version).public for name, version in closure.items()}
    assert {"numpy", "open3d-cpu", "pytest", "kiwisolver"} <= installed.keys()  # runtime, dev and transitive ones
    pins = constraints()
    assert {name: pins.get(name, "not pinned") for name in installed} == installed


def test_the_plain_package_needs_few_packages():
    needed = installed_closure(PROJECT, frozenset())
    assert {"numpy", "scipy", "numba", "trimesh"} <= needed.keys()
    assert not {"open3d-cpu", "open3d", "pyrender", "faiss-cpu", "plotly", "torch", "kiss-icp"} & needed.keys()
    assert len(needed) <= 40


def test_the_extra_for_everything_has_the_extras_of_all_components():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = [requires for _, _, _, *several in BUILT_IN for requires in several]
    (everything,) = map(Requirement, extras["all"])
    assert {extra for text in named for extra in Requirement(text).extras} <= everything.extras <= extras.keys()


def test_constraints_are_sorted_exact_pins_with_normalised_names():
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9-]+==[0-9][0-9a-z.]*", line) for line in lines)
    names = [line.split("==")[0] for line in lines]
    assert names == sorted(set(names))
    assert PROJECT not in names


def test_every_direct_dependency_is_pinned_to_an_allowed_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    declared = [Requirement(text) for text in project["dependencies"] + extras["dev"] + extras["mutate"]]
    here = [r for r in declared if r.marker is None or r.marker.evaluate()]
    pins = constraints()
    refused = [str(r) for r in here if not r.specifier.contains(pins.get(canonicalize_name(r.name), "0"))]
    assert refused == []


def test_the_command_and_the_plugin_group_are_installed():
    installed = metadata.distribution(PROJECT).entry_points
    (script,) = installed.select(group="console_scripts", name=PROJECT)
    assert script.value == "tactile_loc_cli.main:main"
    assert {"tactile_loc.plugins", "tactile_loc_cli"} <= {
        point.value for point in installed.select(group="tactile_loc")
    }


def test_the_annexes_are_installed_checked_and_tested_from_this_tree():
    names = " ".join(sorted(ANNEXES))
    assert f"$(foreach name,{names},plugins_contrib/tactile-loc-$(name)/pyproject.toml)" in MAKEFILE
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
    tested = {path for pattern in settings["pytest"]["ini_options"]["testpaths"] for path in ROOT.glob(pattern)}
    for distribution in ANNEXES.values():
        assert ROOT / "plugins_contrib" / distribution / "tests" in tested
        package = distribution.replace("-", "_")
        assert f"plugins_contrib/{distribution}/{package}" in settings["mypy"]["files"]
        assert any(f"{package}.*" in override["module"] for override in settings["mypy"]["overrides"])
        assert f"plugins_contrib/{distribution}" in (SCRIPTS / "smoke-wheel.sh").read_text()


@pytest.mark.parametrize(
    "name",
    ["constraints.txt", "Makefile", "pyproject.toml", ".ci/run", *(f"scripts/{p.name}" for p in SCRIPTS.glob("*.sh"))],
)
def test_installation_files_contain_no_machine_paths_and_scripts_are_executable(name):
    lines = (ROOT / name).read_text().splitlines()
    assert [line for line in lines if MACHINE_SPECIFIC.search(line.replace("/path/to/", ""))] == []
    assert name.endswith((".txt", "file", ".toml")) or (ROOT / name).stat().st_mode & 0o111


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory) -> list[str]:
    """The names of the files in a wheel built from a copy of the sources."""
    pytest.importorskip("setuptools", minversion="77")  # older versions cannot read the licence
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("tactile_loc", "cli"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    build = f"from setuptools import build_meta; build_meta.build_wheel({str(out)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    (wheel,) = out.glob("*.whl")
    return zipfile.ZipFile(wheel).namelist()


def test_the_wheel_ships_the_licence(wheel_names):
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in wheel_names)
    text = (ROOT / "LICENSE").read_text()
    assert text.startswith("MIT License")
    assert "2026 The tactile-loc authors" in text


def test_the_wheel_ships_every_source_and_data_file(wheel_names):
    shipped = [("tactile_loc", ROOT / "tactile_loc"), ("tactile_loc_cli", ROOT / "cli" / "tactile_loc_cli")]
    wanted = {
        f"{package}/{path.relative_to(folder).as_posix()}"
        for package, folder in shipped
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert wanted - set(wheel_names) == set()
    assert not [name for name in wheel_names if name.startswith("tests/")]
