import importlib
import sys
import textwrap
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Literal

import pytest
from message_helpers import naming
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.runtime.errors import (
    ConfigError,
    MissingLibraryError,
    PluginConflictError,
    PluginLoadError,
    UnknownPluginError,
)
from tactile_loc.plugin import RefinedPose, Refiner
from tactile_loc.plugin.helpers import Component
from tactile_loc.slots.registry import ADDED, SLOTS, Registry, registry, validate_options

HOOK = """
from tactile_loc.slots.registry import ComponentSpec, hookimpl

@hookimpl
def tactile_loc_components():
    return [{specs}]
"""


def spec(slot: str, name: str, target: str, requires: str = "") -> str:
    return f"ComponentSpec({slot!r}, {name!r}, {target!r}, 'a test', {requires!r}, interface=2)"


@pytest.fixture(autouse=True)
def fresh_registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv("TACTILE_LOC_PLUGINS", raising=False)
    registry.cache_clear()
    yield
    registry.cache_clear()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Write a distribution as pip does: `install("acme-tools", acme_plugin=source)`; `*_plugin` are entry points."""
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)

    def lay_out(distribution: str, **modules: str) -> None:
        info = tmp_path / f"{distribution.replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        names = [name for name in modules if name.endswith("_plugin")]
        (info / "entry_points.txt").write_text("[tactile_loc]\n" + "".join(f"{n} = {n}\n" for n in names))
        for name, source in modules.items():
            (tmp_path / f"{name}.py").write_text(textwrap.dedent(source))
        importlib.invalidate_caches()

    yield lay_out
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "/").is_relative_to(tmp_path):
            del sys.modules[name]


def hook(*specs: str) -> str:
    return HOOK.format(specs=", ".join(specs))


def test_every_slot_has_built_in_components_of_its_type():
    found = registry()
    assert found.failures == []
    built_in = [c for c in found.components if c.distribution == "tactile-loc"]
    assert {c.spec.slot for c in built_in} == set(SLOTS)
    for component in built_in:
        kind = found.load(component.spec.slot, component.spec.name)
        assert issubclass(kind, Component)
        assert kind.slot == component.spec.slot
        assert component.spec.summary


@pytest.mark.parametrize(
    ("slot", "name", "values"),
    [
        ("refiner", "icpp", ("refiner", "'icpp'", "none", "'icp'")),
        ("painter", "icp", ("'painter'", "sensor", "renderer", "grid")),
    ],
)
def test_an_unknown_name_or_slot_gives_an_error_with_those_that_exist(slot, name, values):
    with pytest.raises(UnknownPluginError, match=naming(*values)):
        registry().find(slot, name)


NO_REFINER = """
from tactile_loc.plugins.refiners.none import NoRefiner
class Acme(NoRefiner):
    pass
"""


def test_an_entry_point_may_name_a_class_which_is_imported_only_when_it_is_loaded(install, tmp_path):
    install("acme-tools", acme_impl=NO_REFINER)
    info = tmp_path / "acme_tools-1.0.dist-info"
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-tools\nVersion: 1.0\nSummary: moves nothing\n")
    (info / "entry_points.txt").write_text("[tactile_loc.refiner]\nacme = acme_impl:Acme\nlost = acme_impl:Lost\n")
    found = registry().find("refiner", "acme")
    assert (found.distribution, found.spec.summary) == ("acme-tools", "moves nothing")
    assert "acme_impl" not in sys.modules
    assert registry().create("refiner", "acme").describe()["class"] == "acme_impl:Acme"
    with pytest.raises(PluginLoadError, match=r"'lost' of acme-tools.*Lost"):
        registry().load("refiner", "lost")


def test_the_group_of_a_kind_with_a_hyphen_has_an_underscore(install, tmp_path):
    """Packaging tools refuse a group with a hyphen."""
    install("acme-tools", acme_impl=NO_REFINER)
    points = tmp_path / "acme_tools-1.0.dist-info" / "entry_points.txt"
    points.write_text("[tactile_loc.touch_source]\nacme = acme_impl:Acme\n")
    (failure, *_) = [*registry().failures, None]
    assert failure is None or "slot='touch-source'" in failure.error


def test_an_entry_point_of_an_unknown_slot_is_a_failure(install, tmp_path):
    install("acme-tools", acme_impl=NO_REFINER)
    points = tmp_path / "acme_tools-1.0.dist-info" / "entry_points.txt"
    points.write_text("[tactile_loc.polisher]\na = acme_impl:Acme\n")
    (failure,) = registry().failures
    assert "the slots are" in failure.error


def test_a_plugin_component_is_imported_only_when_it_is_loaded(install):
    install("acme-tools", acme_plugin=hook(spec("refiner", "acme", "acme_impl:Acme")), acme_impl=NO_REFINER)
    found = registry().find("refiner", "acme")
    assert found.distribution == "acme-tools"
    assert "acme_impl" not in sys.modules
    assert registry().create("refiner", "acme").describe()["class"] == "acme_impl:Acme"
    assert registry().names("refiner")[-1] == "acme", "built-in components come first"


def test_equal_names_conflict_only_when_the_name_is_requested(install):
    install("acme-tools", acme_plugin=hook(spec("refiner", "twin", "a:A"), spec("refiner", "alone", "a:A")))
    install("brand-tools", brand_plugin=hook(spec("refiner", "twin", "b:B"), spec("matcher", "alone", "b:B")))
    with pytest.raises(PluginConflictError, match=naming("refiner", "'twin'", "acme-tools", "brand-tools")):
        registry().find("refiner", "twin")
    assert registry().find("refiner", "alone").distribution == "acme-tools"
    assert registry().find("matcher", "alone").distribution == "brand-tools"


KIND = """\
from tactile_loc.plugin import hookimpl
from tactile_loc.plugin.helpers import ComponentKind

@hookimpl
def register_kinds():
    return [ComponentKind("camera-mount", "zeta_checks", "zeta", "a rigid mount", "tactile-loc mount {name}")]
"""


def test_a_package_defines_a_kind_for_components_of_other_packages(install):
    install("acme-tools", acme_plugin=hook(spec("camera-mount", "acme", "a:A")))
    install("zeta-tools", zeta_plugin=KIND)
    found = registry()
    assert found.failures == []
    assert found.find("camera-mount", "acme").distribution == "acme-tools"
    assert found.kinds["camera-mount"].checks == "zeta_checks"


BROKEN = {
    "raises": "raise RuntimeError('no licence')",
    "syntax": "def",
    "missing": "import a_library_that_nobody_has",
    "wrong slot": hook(spec("painter", "x", "a:A")),
    "no spec": HOOK.format(specs="'icp'"),
    "no list": HOOK.replace("[{specs}]", "None"),
    "no hook": "x = 1",
    "wrong arguments": HOOK.replace("components()", "components(colour)").replace("{specs}", ""),
    "misspelt hook": HOOK.replace("components()", "component()").replace("{specs}", ""),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_failing_plugin_does_not_affect_others(install, how):
    install("broken-tools", broken_plugin=BROKEN[how])
    found = registry()
    (failure,) = found.failures
    assert (failure.plugin, failure.distribution) == ("broken_plugin", "broken-tools")
    assert ":" in failure.error, "the error has its type and message"
    assert found.create("refiner", "none") is not None
    error = failure.error.partition(":")[0]
    with pytest.raises(UnknownPluginError, match=naming("of-the-broken-one", "broken_plugin", error)):
        found.load("refiner", "of-the-broken-one")


@pytest.mark.parametrize(
    ("source", "error", "values"),
    [
        ("import a_library_nobody_has", MissingLibraryError, ("a_library_nobody_has", "pip install acme-lib")),
        ("import nobody_has_this", MissingLibraryError, ("pip install nobody_has_this",)),
        ("raise OSError('libusb.so')", PluginLoadError, ("acme-tools", "OSError: libusb.so")),
        ("def", PluginLoadError, ("acme-tools", "SyntaxError")),
        ("Other = 1", PluginLoadError, ("acme-tools", "AttributeError")),
        ("import acme_impl.lost", PluginLoadError, ("acme-tools", "acme_impl.lost")),
        ("class Acme: pass", PluginLoadError, ("acme-tools", "acme_impl.Acme")),
        ("from tactile_loc.plugin import Matcher as Acme", PluginLoadError, ("acme-tools", "matcher.Matcher")),
        ("from tactile_loc.plugin import Refiner as Acme", PluginLoadError, ("acme-tools", "Refiner")),
    ],
)
def test_loading_an_unimportable_component_gives_the_reason(install, source, error, values):
    library = "acme-lib" if "pip install acme-lib" in values else ""
    install("acme-tools", acme_plugin=hook(spec("refiner", "acme", "acme_impl:Acme", library)), acme_impl=source)
    found = registry()
    assert found.failures == []
    assert "acme" in found.names("refiner")
    with pytest.raises(error, match=naming("refiner", "'acme'", *values)):
        found.load("refiner", "acme")


@pytest.mark.parametrize(
    ("allowed", "names"),
    [
        (None, {"acme", "brand"}),
        ("", set()),
        ("nobody", set()),
        ("acme_plugin", {"acme"}),
        ("brand-tools", {"brand"}),
        (" acme-tools , brand_plugin", {"acme", "brand"}),
    ],
)
def test_the_environment_variable_restricts_plugins_and_not_built_ins(install, monkeypatch, allowed, names):
    install("acme-tools", acme_plugin=hook(spec("refiner", "acme", "a:A")))
    install("brand-tools", brand_plugin=hook(spec("refiner", "brand", "b:B")))
    if allowed is not None:
        monkeypatch.setenv("TACTILE_LOC_PLUGINS", allowed)
    found = set(registry().names("refiner"))
    assert found & {"acme", "brand"} == names
    assert "icp" in found


def test_a_disallowed_plugin_is_not_imported(install, monkeypatch):
    install("broken-tools", broken_plugin="raise RuntimeError('imported')")
    monkeypatch.setenv("TACTILE_LOC_PLUGINS", "")
    assert registry().failures == []


def test_an_entry_point_without_a_distribution_is_loaded():
    found = Registry([EntryPoint("lone", "tactile_loc.plugins", "tactile_loc")])
    assert "icp" in found.names("refiner")


class Paint(BaseModel):
    model_config = ConfigDict(extra="forbid")
    colour: str = "red"
    coats: int = Field(default=2, ge=1)
    finish: Literal["matt", "gloss"] = "matt"


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"coats": "many"}, ("coats", "'many'", "whole number")),
        ({"coats": 0}, ("coats", 0, "1")),
        ({"finish": "satin"}, ("finish", "'satin'", "'matt'")),
        ({"colour": 5}, ("colour", 5)),
        ({"color": "blue"}, ("'color'", "'colour'", "colour (str)", "coats (int)", "finish")),
    ],
)
def test_an_invalid_option_value_gives_an_error_with_the_fault(values, problem):
    with pytest.raises(ConfigError, match=naming("brush 'b'", *problem)) as refused:
        validate_options(Paint, values, "brush 'b'")
    assert "\n" not in str(refused.value)


class Still(Refiner):
    """Returns the candidate."""

    def refine(self, touch, candidate, scene):
        return RefinedPose(candidate.T_sensor_object, 0.0, converged=False, iterations=0)


def test_an_added_class_is_chosen_like_a_built_in_one():
    registry().add(Still, "still", "moves nothing")
    found = registry().find("refiner", "still")
    assert (found.spec.summary, found.distribution) == ("moves nothing", ADDED)
    assert "still" in registry().names("refiner")
    assert type(registry().create("refiner", "still", {})) is Still
    with pytest.raises(ConfigError, match="rounds"):
        registry().create("refiner", "still", {"rounds": 3})


def test_an_added_class_replaces_an_earlier_one_and_no_class_of_a_package():
    registry().add(Still, "still")
    again = type("Still", (Still,), {"__module__": Still.__module__})  # as if the cell of a notebook ran again
    registry().add(again, "still")
    assert registry().names("refiner").count("still") == 1
    assert registry().load("refiner", "still") is again
    with pytest.raises(PluginConflictError, match="tactile-loc"):
        registry().add(Still, "joint")
    assert registry().load("refiner", "joint") is not Still


@pytest.mark.parametrize(
    "kind", [int, Refiner, Component, Still()], ids=["no component", "abstract", "no slot", "object"]
)
def test_only_complete_component_classes_can_be_added(kind):
    before = list(registry().components)
    with pytest.raises(PluginLoadError):
        registry().add(kind, "still")
    assert registry().components == before
