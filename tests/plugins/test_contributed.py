"""The contributed plugins: each builds, installs, passes its own tests, and uses only the public API."""

import ast
import re
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
import tactile_loc_cli
from tactile_loc_cli.scaffold.package import Naming, render

import tactile_loc
from tactile_loc.slots.registry import SLOTS

CONTRIBUTED = Path(__file__).parents[2] / "plugins_contrib"
FOUND = sorted(path.parent.name for path in CONTRIBUTED.glob("*/pyproject.toml"))
# Annexes add commands. They are installed from this tree, and `make test` runs their tests.
ANNEXES = [name for name in FOUND if name in tactile_loc_cli.ANNEXES.values()]
DISTRIBUTIONS = [name for name in FOUND if name not in ANNEXES]
EXAMPLE = Path(__file__).parents[2] / "examples" / "plugin"
PUBLIC = ("tactile_loc.plugin", "tactile_loc.commands", "tactile_loc.testing")
each = pytest.mark.parametrize("name", DISTRIBUTIONS)


@pytest.fixture(scope="module")
def site(install_offline) -> Path:
    """The folder in which all plugins are installed."""
    return install_offline(*(CONTRIBUTED / name for name in DISTRIBUTIONS))


def extends(name: str) -> bool:
    """Return whether a distribution adds components or commands to tactile-loc."""
    return any(group.startswith("tactile_loc") for group in project(name).get("entry-points", {}))


def project(name: str) -> dict:
    return tomllib.loads((CONTRIBUTED / name / "pyproject.toml").read_text())["project"]


def find_missing(name: str) -> list[str]:
    """Return the libraries that a distribution needs and that are not installed."""
    missing = []
    for needed in project(name)["dependencies"]:
        library = re.split(r"[<>=!~ \[;]", needed)[0]
        try:
            version(library)
        except PackageNotFoundError:
            missing.append(library)
    return missing


def imported(text: str) -> Iterator[str]:
    """Yield the modules that a source imports, by statement or by name: `from a import b` yields a and a.b."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            yield from (base, *(f"{base}.{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "tactile_loc.plugins" in node.value:
            yield node.value


def private(text: str) -> list[str]:
    """Return a source's imports of tactile-loc beyond the public API, the plugin API and the contract checks."""
    ours = re.compile(r"tactile_loc(_cli)?(\.|$)|.*tactile_loc\.plugins")
    of_ours = filter(ours.match, imported(text))
    allowed = {"tactile_loc", *(f"tactile_loc.{n}" for n in tactile_loc.__all__), *PUBLIC}
    return [name for name in of_ours if name not in allowed and not name.startswith(tuple(f"{p}." for p in PUBLIC))]


def test_contributed_plugins_exist():
    assert len(DISTRIBUTIONS) >= 3


@each
def test_only_the_public_api_is_imported(name):
    sources = list((CONTRIBUTED / name).rglob("*.py"))
    assert len(sources) >= 2
    assert {str(path): private(path.read_text()) for path in sources if private(path.read_text())} == {}


@pytest.mark.parametrize("name", ANNEXES)
def test_an_annex_imports_only_the_public_api(name):
    package = CONTRIBUTED / name / name.replace("-", "_")
    inner = {str(path): private(path.read_text()) for path in package.rglob("*.py") if private(path.read_text())}
    assert inner == {}


@pytest.mark.parametrize("name", ANNEXES)
def test_the_readme_of_an_annex_has_the_command_that_installs_it(name):
    assert f"pip install ./plugins_contrib/{name}" in (CONTRIBUTED / name / "README.md").read_text()


@pytest.mark.parametrize(
    "text",
    [
        "from tactile_loc_cli.console import say",
        "import tactile_loc.plugins.refiners.icp",
        "def f():\n    from tactile_loc.plugins.grids import lattice",
        "from tactile_loc import plugins",
        "importlib.import_module('tactile_loc.plugins.encoders.pixel')",
        "from tactile_loc.core.poses.pose_errors import compute_adds",
        "from tactile_loc.core.sensing.scene import Scene",
    ],
)
def test_a_private_import_is_noticed(text):
    assert private(text)
    assert not private("from tactile_loc import Localizer\nfrom tactile_loc.plugin import Scene\nimport numpy")


def test_the_example_and_generated_plugins_import_only_the_public_api():
    written = [(path, text) for slot in SLOTS for path, text in render(Naming(slot, f"my-{slot}")).items()]
    sources = [path.read_text() for path in EXAMPLE.rglob("*.py")] + [t for path, t in written if path.endswith(".py")]
    assert len(sources) >= 3 + 3 * len(SLOTS)
    assert [private(text) for text in sources if private(text)] == []


@each
def test_each_readme_describes_the_plugin_and_its_installation(name):
    readme = (CONTRIBUTED / name / "README.md").read_text()
    assert re.search(rf"pip install (-e |\./)plugins_contrib/{name}\b", readme)
    assert project(name)["name"] == name
    used = "from " + name.replace("-", "_") + " import"
    assert extends(name) or used in readme or name in project(name)["scripts"]


@pytest.mark.slow
def test_all_are_listed_with_their_distribution(site, tmp_path, run_python):
    listed = run_python(site, tmp_path, "-m", "tactile_loc_cli.main", "plugins")
    assert listed.returncode == 0, listed.stderr
    assert "Error: " not in listed.stdout + listed.stderr
    for name in filter(extends, DISTRIBUTIONS):
        assert f" {name} " in listed.stdout, f"{name}:\n{listed.stdout}"


@pytest.fixture(scope="module")
def own_tests(site, run_own_tests) -> str:
    """The output of the tests of all plugins whose libraries are installed."""
    complete = [name for name in DISTRIBUTIONS if not find_missing(name)]
    return run_own_tests(site, {name: CONTRIBUTED / name / "tests" for name in complete})


@pytest.mark.slow
@each
def test_its_own_tests_pass(own_tests, name):
    if missing := find_missing(name):
        pytest.skip(f"{name} needs libraries that are not installed: pip install {' '.join(missing)}")
    said = [line for line in own_tests.splitlines() if line.startswith((f"FAILED {name}/", f"ERROR {name}/"))]
    assert said == [], own_tests
    assert len(re.findall(rf"^PASSED {name}/", own_tests, re.MULTILINE)) >= 5, own_tests
