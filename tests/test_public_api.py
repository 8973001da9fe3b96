from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tactile_loc

PROJECT = Path(__file__).parents[1]
HEAVY = ("numpy", "scipy", "trimesh", "open3d", "torch", "numba", "faiss", "pydantic", "matplotlib", "pyrender")


def imported_by(statement: str) -> set[str]:
    """The top-level packages among HEAVY that a statement imports, in a process of its own."""
    script = f"import sys\n{statement}\nprint(*[m for m in {HEAVY!r} if m in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=PROJECT)
    return set(ran.stdout.split())


def test_importing_the_package_costs_nothing():
    assert imported_by("import tactile_loc; dir(tactile_loc); tactile_loc.__version__") == set()


def test_listing_plugins_imports_none_of_their_libraries():
    statement = "from tactile_loc.core.registry import registry; assert registry().components"
    assert imported_by(statement) <= {"pydantic"}


def test_the_localizer_imports_no_library_of_a_component_that_is_not_selected():
    assert imported_by("from tactile_loc import Localizer") <= {"numpy", "pydantic"}


def declared_names() -> list[str]:
    """What type checkers are told that the package offers."""
    tree = ast.parse(Path(tactile_loc.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    return [
        alias.asname or alias.name for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    ]


@pytest.mark.parametrize("name", declared_names())
def test_every_public_name_is_there_and_documented(name):
    thing = getattr(tactile_loc, name)
    assert thing.__doc__ or name == "hookimpl"
    assert name in dir(tactile_loc)


def test_type_checkers_and_python_see_the_same_names():
    public = {name for name in dir(tactile_loc) if not name.startswith("_")} - set(vars(tactile_loc))
    assert public == set(declared_names()) - set(vars(tactile_loc))
    assert {"Localizer", "ObjectModel", "Touch", "PosePosterior"} <= set(declared_names())


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'tactile_loc' has no attribute 'Localiser'"):
        _ = tactile_loc.Localiser
    with pytest.raises(ImportError):
        exec("from tactile_loc import Localiser")


def imports_of(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute here"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def modules(folder: str) -> list[Path]:
    found = sorted((PROJECT / "tactile_loc" / folder).rglob("*.py"))
    assert found
    return found


def test_core_imports_no_plugin_and_nothing_above_it():
    above = ("tactile_loc.plugins", "tactile_loc.evaluation", "tactile_loc.testing", "tactile_loc_cli")
    wrong = [(p.name, name) for p in modules("core") for name in imports_of(p) if name.startswith(above)]
    assert wrong == []


def test_core_knows_no_renderer_viewer_or_learner():
    heavy = ("torch", "open3d", "pyrender", "matplotlib", "faiss")
    wrong = [(p.name, name) for p in modules("core") for name in imports_of(p) if name.split(".")[0] in heavy]
    assert wrong == []


def test_no_plugin_imports_another():
    """What two share lives in core or beside them, in a module that is no component."""
    from tactile_loc.plugins import tactile_loc_components

    components = {spec.target.partition(":")[0] for spec in tactile_loc_components()}
    for path in modules("plugins"):
        own = ".".join(path.relative_to(PROJECT).with_suffix("").parts)
        for name in imports_of(path):
            module = name.rpartition(".")[0]
            assert module == own or module not in components, f"{own} imports {name}"
            if module.startswith("tactile_loc.plugins."):
                assert module.split(".")[2] == own.split(".")[2], f"{own} imports from another slot: {name}"


def test_plugins_import_nothing_above_them():
    above = ("tactile_loc.evaluation", "tactile_loc_cli")
    wrong = [(p.name, name) for p in modules("plugins") for name in imports_of(p) if name.startswith(above)]
    assert wrong == []
