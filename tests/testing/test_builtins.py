"""Every built-in component keeps every contract."""

from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from press_sets import write_calibrated

from tactile_loc import TriangleMesh
from tactile_loc.plugin import Encoder, MissingLibraryError, Renderer, RenderError
from tactile_loc.plugin.helpers import Component
from tactile_loc.plugins.grids.whole import WholeGrid
from tactile_loc.slots.registry import BUILT_IN, SLOTS, registry
from tactile_loc.testing import Check, list_checks, parametrize_with_checks, parametrize_with_properties
from tactile_loc.testing.problems import CAMERAS, ReferenceRenderer, make_training_problem

ROOT = Path(__file__).parents[2]
FOLDER = TemporaryDirectory()
OPTIONS = {
    ("sensor", "calibrated"): {"path": str(write_calibrated(Path(FOLDER.name)))},
    ("sensor", "file"): {"path": str(ROOT / "examples" / "my_sensor.toml")},
    ("encoder", "moco"): {"epochs": 2, "queries": 64, "batch": 32, "channels": 4, "noise": "none"},
}
VARIANTS = [("matcher", "faiss", {"kind": "hnsw", "top_k": 50}), ("matcher", "faiss", {"kind": "ivf", "top_k": 50})]


def built_ins() -> Iterator[Component]:
    """The components of this distribution whose libraries are installed; other plugins have their own tests."""
    offered = [(c.spec.slot, c.spec.name) for c in registry().components if c.distribution == BUILT_IN]
    for slot, name, options in [*((*key, OPTIONS.get(key)) for key in offered), *VARIANTS]:
        with suppress(MissingLibraryError):
            yield registry().create(slot, name, options)


def quick(component: Component) -> Component:
    """The same component, or a grid with fewer places, since properties list them often."""
    return WholeGrid(WholeGrid.Options(directions=1000)) if isinstance(component, WholeGrid) else component


ALL = [*built_ins(), ReferenceRenderer()]
QUICK = [quick(component) for component in ALL]


@parametrize_with_checks(ALL)
def test_contract(component, check):
    try_on(component, check)


@parametrize_with_properties(QUICK)
def test_property(component, check):
    try_on(component, check)


def try_on(component: Component, check: Check) -> None:
    """Run a check; skip a renderer that cannot run here, and train an encoder first."""
    if isinstance(component, Renderer):
        skip_without_opengl(component)
    if component.capabilities.needs_training:
        train(component)
    check(component)


@lru_cache
def train(encoder: Encoder) -> None:
    """Train each encoder once, for all checks."""
    encoder.fit(make_training_problem())


def skip_without_opengl(renderer: Renderer) -> None:
    triangle = TriangleMesh(np.eye(3), np.array([[0, 1, 2]]))
    try:
        renderer.render(triangle, np.eye(4)[None], CAMERAS["pinhole"])
    except RenderError as error:
        if "pyrender" not in type(renderer).__module__:
            raise
        pytest.skip(str(error))


def test_all_slots_are_checked():
    chosen = {c.slot: len(list_checks(c)) for c in built_ins()}
    assert chosen.keys() == set(SLOTS)
    assert min(chosen.values()) > 8
