"""The API reference has every public name, each once, and the methods that users call on a Localizer."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import griffe
import pytest
import yaml

ROOT = Path(__file__).parents[1]
REFERENCE = "\n".join(page.read_text() for page in sorted((ROOT / "docs" / "api").glob("*.md")))
ENTRIES = re.findall(r"^::: (\S+)$", REFERENCE, re.MULTILINE)
IN_TABLES = set(re.findall(r"^\| `(\w+)` \|", REFERENCE, re.MULTILINE))  # types and constants: they have no docstring


@pytest.fixture(scope="module")
def code() -> griffe.ModulesCollection:
    """The package as the site's builder reads it, without importing it."""
    loader = griffe.GriffeLoader(search_paths=[ROOT])
    loader.load("tactile_loc")
    return loader.modules_collection


def home(code: griffe.ModulesCollection, path: str) -> griffe.Object:
    """What a path means, where it is defined; KeyError if there is no such thing."""
    thing = code[path]
    return thing.final_target if isinstance(thing, griffe.Alias) else thing


@pytest.mark.parametrize("module", ["tactile_loc", "tactile_loc.plugin"])
def test_every_public_name_is_in_the_reference(module, code):
    shown = {home(code, entry).path for entry in ENTRIES}

    def is_shown(name: str) -> bool:
        if name in IN_TABLES:
            return True
        thing = home(code, f"{module}.{name}")
        return thing.path in shown or thing.parent.path in shown

    names = importlib.import_module(module).__all__
    assert len(names) > 40
    assert [name for name in names if not is_shown(name)] == []


def test_every_entry_is_there_once(code):
    paths = [home(code, entry).path for entry in ENTRIES]
    assert sorted(set(paths)) == sorted(paths)
    modules = {path for path in paths if code[path].is_module}
    members = [path for path in paths if path not in modules and path.rpartition(".")[0] in modules]
    assert members == [], "their modules have entries, which show them"


def test_inherited_members_are_shown_and_a_localizer_has_those_that_users_call(code):
    plugins = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["plugins"]
    (options,) = (p["mkdocstrings"]["handlers"]["python"]["options"] for p in plugins if "mkdocstrings" in p)
    assert options["inherited_members"] is True
    localizer = home(code, "tactile_loc.Localizer")
    for name in ("create", "localize", "read_touch", "simulate"):
        assert localizer.all_members[name].has_docstring
