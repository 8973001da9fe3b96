"""The API reference contains every public name once, and the methods that users call on a Localizer."""

import importlib
import re

import griffe
import pytest
from page_helpers import DOCS, ROOT
from site_helpers import read_settings

REFERENCE = "\n".join(page.read_text() for page in sorted((DOCS / "api").glob("*.md")))
ENTRIES = re.findall(r"^::: (\S+)$", REFERENCE, re.MULTILINE)
IN_TABLES = set(re.findall(r"^\| `(\w+)` \|", REFERENCE, re.MULTILINE))  # types and constants, which have no docstring


@pytest.fixture(scope="module")
def code() -> griffe.ModulesCollection:
    """The package as the site builder reads it, without importing it."""
    annexes = sorted((ROOT / "plugins_contrib").glob("tactile-loc-*"))
    loader = griffe.GriffeLoader(search_paths=[ROOT, *annexes])
    for name in sorted({entry.partition(".")[0] for entry in ENTRIES}):
        loader.load(name)
    return loader.modules_collection


def home(code: griffe.ModulesCollection, path: str) -> griffe.Object:
    """Return the object of a path at its definition; KeyError if there is none."""
    thing = code[path]
    return thing.final_target if isinstance(thing, griffe.Alias) else thing


@pytest.mark.parametrize("module", ["tactile_loc", "tactile_loc.plugin", "tactile_loc.plugin.helpers"])
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


def test_every_entry_occurs_once(code):
    paths = [home(code, entry).path for entry in ENTRIES]
    assert sorted(set(paths)) == sorted(paths)
    modules = {path for path in paths if code[path].is_module}
    members = [path for path in paths if path not in modules and path.rpartition(".")[0] in modules]
    assert members == [], "the entries of their modules show them already"


def test_the_reference_shows_inherited_members_of_the_localizer(code):
    plugins = read_settings()["plugins"]
    (options,) = (p["mkdocstrings"]["handlers"]["python"]["options"] for p in plugins if "mkdocstrings" in p)
    assert options["inherited_members"] is True
    localizer = home(code, "tactile_loc.Localizer")
    for name in ("create", "localize", "read_touch", "simulate"):
        assert localizer.all_members[name].has_docstring
