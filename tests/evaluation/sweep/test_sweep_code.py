"""A sweep with a refiner whose code is edited between two calls."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tactile_loc.evaluation.jobs import do_job
from tactile_loc.evaluation.sweep.plan import Plan
from tactile_loc.evaluation.sweep.sweep import Sweep, run_sweep
from tactile_loc.slots.code import hash_component
from tactile_loc.slots.registry import registry

HOOK = """
from tactile_loc.plugin import ComponentSpec, hookimpl

@hookimpl
def tactile_loc_components():
    return [ComponentSpec("refiner", "edited", "edited_refiner:Edited", "made up", interface=2)]
"""
REFINER = """
from edited_settings import ROUNDS
from tactile_loc.plugins.refiners.filterreg.refiner import FilterRegRefiner

class Edited(FilterRegRefiner):
    class Options(FilterRegRefiner.Options):
        rounds: int = ROUNDS
"""
UNMOVED = """
    def refine_many(self, touch, candidates, scene):
        return NoRefiner().refine_many(touch, candidates, scene)

from tactile_loc.plugins.refiners.none import NoRefiner
"""


class Here:
    """Does the jobs in this process."""

    def run_jobs(self, jobs, objects):
        for job in jobs:
            yield do_job(job, objects[job.key])


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of an installed distribution with the refiner `edited`."""
    folder = tmp_path / "site"
    info = folder / "edited-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: edited\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tactile_loc]\nedited = edited_hook\n")
    (folder / "edited_hook.py").write_text(HOOK)
    (folder / "edited_refiner.py").write_text(REFINER)
    (folder / "edited_settings.py").write_text("ROUNDS = 5\n")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    return folder


@pytest.fixture
def sweep(site, tiny, tmp_path) -> Callable[[str], Sweep]:
    """Sweep as a new process does, into a new folder but with the same store."""

    def run(out: str) -> Sweep:
        for name in [name for name in sys.modules if name.startswith("edited_")]:
            del sys.modules[name]
        importlib.invalidate_caches()
        hash_component.cache_clear()
        registry.cache_clear()
        plan = Plan.from_values({**tiny, "object": "pin", "refiner": ["none", "edited"]})
        return run_sweep(plan, tmp_path / out, tmp_path / "store", Here())

    yield run
    registry.cache_clear()


def test_an_edited_refiner_gets_new_results_and_unchanged_code_is_read_from_the_store(site, sweep):
    first = sweep("first")
    assert (len(first.done), first.evaluated) == (2, 2)
    (site / "edited_unrelated.py").write_text("A = 1\n")
    same = sweep("same")
    assert (len(same.done), same.evaluated, same.built) == (2, 0, {})
    assert [row["reg-1_median_mm"] for row in same.rows] == [row["reg-1_median_mm"] for row in first.rows]
    module = site / "edited_refiner.py"
    module.write_text(REFINER + UNMOVED)
    second = sweep("second")
    assert (len(second.done), second.evaluated, second.built) == (2, 1, {"evaluation": 1})
    none, edited = second.rows
    assert first.rows[1]["reg-1_median_mm"] != edited["reg-1_median_mm"] == none["reg-1_median_mm"]
    module.write_text(REFINER)
    (site / "edited_settings.py").write_text("ROUNDS = 1\n")
    third = sweep("third")
    assert third.evaluated == 1
    again = sweep("third")
    assert (again.done, again.evaluated, again.built_now) == ([], 0, {})
    assert again.built == third.built == third.built_now
