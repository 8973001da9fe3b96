"""The pages on plugins match the code: examples, tables of slots, errors and versions."""

import re
from dataclasses import dataclass, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from message_helpers import missing
from tactile_loc_cli.scaffold.examples import make_examples

from tactile_loc import plugin
from tactile_loc.core.runtime.errors import (
    MissingLibraryError,
    PluginConflictError,
    PluginLoadError,
    UnknownPluginError,
)
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.slots.component import Capabilities
from tactile_loc.slots.interface import INTERFACE_VERSION
from tactile_loc.slots.registry import PROJECT, SLOTS, ComponentSpec, Registry, hookimpl
from tactile_loc.testing import ContractError

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "plugin"
PAGE = (ROOT / "docs" / "plugins.md").read_text()
EXAMPLES = (ROOT / "docs" / "plugin-examples.md").read_text()
KINDS = {
    kind.slot: kind
    for kind in (
        plugin.SensorModel, plugin.Renderer, plugin.GridSampler, plugin.Encoder, plugin.Matcher, plugin.Refiner,
        plugin.Fuser,
    )
}  # fmt: skip


def test_exactly_the_example_files_are_shown_unchanged():
    found = (p.relative_to(EXAMPLE) for p in EXAMPLE.rglob("*") if p.suffix in (".py", ".toml"))
    files = {str(p): (EXAMPLE / p).read_text() for p in found if p.parts[0] != "build"}
    assert dict(re.findall(r"^`([\w/.]+)`\n\n```\w+\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)) == files


def test_the_component_without_a_package_is_used_and_replaced():
    code = re.search(r"^## Without a package.*?^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert code
    found: dict[str, Any] = {}
    plugin.registry.cache_clear()
    try:
        exec(code[1], found)
        refiner, scene = found["localizer"].refinement.refiner, found["localizer"].scene.press(1e-3)
        assert isinstance(refiner, found["LazyRefiner"])
        T = scene.bring_to_contact(np.eye(4)[None])[0][0]
        touch = plugin.Touch(scene.contact_shape(T, 1e-3), scene.geometry)
        refined = refiner.refine(touch, plugin.Candidate(T, 0, 0.0), scene)
        assert np.array_equal(refined.T_sensor_object, T)
        assert refined.contact_iou > 0.95
        exec(code[1], found)
        assert plugin.registry().names("refiner").count("lazy") == 1
        with pytest.raises(PluginConflictError):
            plugin.registry().add(found["LazyRefiner"], "joint")
        with pytest.raises(PluginLoadError):
            plugin.registry().add(plugin.Refiner, "lazy")
    finally:
        plugin.registry.cache_clear()


def test_the_custom_property_example_passes_and_can_fail():
    code = re.search(r"^A property of your own.*?^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert code
    exec(code[1], {})
    with pytest.raises(ContractError, match=r"\boff=Place\("):
        exec(code[1].replace("2e-3", "1e-9"), {})


@pytest.mark.parametrize("slot", SLOTS)
def test_every_slot_has_checks_and_properties_in_the_tables(slot):
    checks = PAGE.partition("## Contract checks")[2].partition("\n## ")[0]
    assert len(re.findall(rf"^\| {slot} \| ", checks, re.MULTILINE)) == 2


@pytest.mark.parametrize("slot", SLOTS)
def test_the_table_names_interface_and_abstract_methods(slot):
    row = re.search(rf"^\| `{slot}` \| (.*)$", PAGE, re.MULTILINE)
    assert row, f"no row for {slot}"
    assert f"`{KINDS[slot].__name__}`" in row[1]
    assert set(re.findall(r"`(\w+)(?:\(| ->)", row[1])) == set(KINDS[slot].__abstractmethods__)


@dataclass
class FakeEntryPoint:
    """A plugin that offers a refiner at `target`, or raises it on loading."""

    name: str
    target: str | Exception
    requires: str = ""
    offers: str = "spline"
    interface: int = INTERFACE_VERSION
    group: str = PROJECT

    @property
    def dist(self) -> Any:
        return SimpleNamespace(name=self.name)

    def load(self) -> Any:
        if isinstance(self.target, Exception):
            raise self.target
        spec = ComponentSpec("refiner", self.offers, self.target, "bends", self.requires, self.interface)
        return SimpleNamespace(tactile_loc_components=hookimpl(lambda: [spec]))


@pytest.mark.parametrize(
    ("error", "plugins"),
    [
        (
            PluginConflictError,
            [FakeEntryPoint("tactile-loc-spline", "json:dumps"), FakeEntryPoint("other-spline", "json:loads")],
        ),
        (MissingLibraryError, [FakeEntryPoint("tactile-loc-spline", "bspline.refine:Spline", requires="bspline")]),
        (PluginLoadError, [FakeEntryPoint("tactile-loc-spline", "json:Spline")]),
        (PluginLoadError, [FakeEntryPoint("tactile-loc-spline", "json:Spline", interface=99)]),
        (PluginLoadError, [FakeEntryPoint("tactile-loc-spline", "json:Spline", interface=1)]),
        (
            UnknownPluginError,
            [
                FakeEntryPoint("tactile-loc", "json:loads", offers="icp"),
                FakeEntryPoint("tactile-loc-spline", SyntaxError("invalid syntax")),
            ],
        ),
    ],
    ids=["conflict", "missing library", "broken class", "later interface", "earlier interface", "broken plugin"],
)
def test_errors_have_the_documented_text(error, plugins):
    found = Registry(plugins)
    with pytest.raises(error) as caught:
        found.load("refiner", "spline")
    assert str(caught.value) in re.sub(r"\s+", " ", PAGE)


def test_the_interface_versions_end_with_the_current_one():
    section = PAGE.partition("## Versions of the interface")[2].partition("\n## ")[0]
    versions = [int(version) for version in re.findall(r"^\| (\d+) \| ", section, re.MULTILINE)]
    assert max(versions) == INTERFACE_VERSION
    assert f"`ComponentSpec(interface={INTERFACE_VERSION})`" in section


def test_the_documented_score_formula_matches_the_dense_matcher():
    (line,) = re.findall(r"^    scores = (.*)$", PAGE, re.MULTILINE)
    rng = np.random.default_rng(0)
    q, w, bank = (rng.uniform(size=(rows, 6)).astype(np.float32) for rows in (3, 3, 9))
    dense = DenseMatcher()
    dense.index(bank)
    np.testing.assert_allclose(eval(line, {"q": q, "w": w, "bank": bank}), dense.scores(q, w), atol=1e-5)


def test_every_capability_is_in_the_table():
    section = PAGE.partition("## Capabilities")[2].partition("\n## ")[0]
    shown = dict(re.findall(r"^\| `(\w+)` \| (true|false|none) \|", section, re.MULTILINE))
    assert shown == {field.name: str(field.default).lower() for field in fields(Capabilities)}


def test_the_failure_row_has_the_documented_text():
    failure = Registry([FakeEntryPoint("tactile-loc-spline", SyntaxError("invalid syntax"))]).failures[0]
    assert not missing(PAGE, failure.plugin, failure.distribution, failure.error)


def test_the_generated_examples_are_up_to_date():
    pytest.importorskip("tactile_loc_benchmark")
    assert make_examples() == EXAMPLES, "run python -m tactile_loc_cli.scaffold.examples"
