import ast
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from message_helpers import naming

import tactile_loc
import tactile_loc.commands
import tactile_loc.plugin.helpers

MODULES = (tactile_loc, tactile_loc.plugin, tactile_loc.plugin.helpers, tactile_loc.commands)
PROJECT = Path(__file__).parents[1]
HEAVY = ("numpy", "scipy", "trimesh", "open3d", "torch", "numba", "faiss", "pydantic", "matplotlib", "pyrender")


def imported_by(statement: str, of: tuple[str, ...] = HEAVY) -> set[str]:
    """The modules among `of` that a statement imports in a separate process."""
    script = f"import sys\nbefore = set(sys.modules)\n{statement}\nprint(*({set(of)!r} & set(sys.modules) - before))"
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=PROJECT)
    return set(ran.stdout.split())


def test_importing_the_package_imports_no_heavy_library():
    assert imported_by("import tactile_loc; dir(tactile_loc); tactile_loc.__version__") == set()


def test_importing_the_package_imports_no_slow_module_of_python():
    slow = ("email", "http", "importlib.metadata", "logging", "multiprocessing", "socket", "subprocess", "zipfile")
    assert imported_by("import tactile_loc", slow) == set()


def test_importing_the_plugin_hook_imports_at_most_pydantic():
    assert (
        imported_by("from tactile_loc import plugin; from tactile_loc.plugin import helpers; dir(plugin); dir(helpers)")
        == set()
    )
    assert imported_by("from tactile_loc.plugin import ComponentSpec, hookimpl") <= {"pydantic"}


def test_listing_plugins_does_not_import_their_libraries():
    statement = "from tactile_loc.slots.registry import registry; assert registry().components"
    assert imported_by(statement) <= {"pydantic"}


def test_the_localizer_imports_no_libraries_of_unselected_components():
    assert imported_by("from tactile_loc import Localizer") <= {"numpy", "pydantic"}


def declared_names(module: ModuleType) -> list[str]:
    """The names of a module that type checkers see."""
    tree = ast.parse(Path(str(module.__file__)).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    return [
        alias.asname or alias.name for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    ]


@pytest.mark.parametrize("module", MODULES)
def test_every_public_name_exists_and_is_documented(module):
    names = declared_names(module)
    undocumented = {name for name in names if not getattr(module, name).__doc__}
    types = {"DepthKind", "DepthUnit", "NoiseLevel", "Prior", "Units"}
    assert undocumented <= {"DEMO_OBJECTS", "hookimpl", *types}
    assert set(names) <= set(dir(module))


@pytest.mark.parametrize("module", MODULES)
def test_type_checkers_and_python_see_the_same_names(module):
    public = {name for name in dir(module) if not name.startswith("_")}
    assert public == set(declared_names(module)) == set(module.__all__)


def test_the_public_names_include_the_main_classes():
    assert {"Localizer", "ObjectModel", "Touch", "PosePosterior"} <= set(tactile_loc.__all__)
    slots = {"SensorModel", "Renderer", "GridSampler", "Encoder", "Matcher", "Refiner", "Fuser"}
    assert slots <= set(tactile_loc.plugin.__all__)
    assert {"Scene", "Candidate", "RefinedPose", "Capabilities"} <= set(tactile_loc.plugin.__all__)


def test_an_author_needs_few_names_and_each_name_has_one_home():
    names, helpers = set(tactile_loc.plugin.__all__), set(tactile_loc.plugin.helpers.__all__)
    assert len(names) <= 45
    assert not names & helpers


@pytest.mark.parametrize("module", MODULES)
def test_an_unknown_name_raises_an_attribute_error(module):
    with pytest.raises(AttributeError, match=naming(module.__name__, "'Localiser'")):
        _ = module.Localiser
    with pytest.raises(ImportError):
        exec(f"from {module.__name__} import Localiser")
