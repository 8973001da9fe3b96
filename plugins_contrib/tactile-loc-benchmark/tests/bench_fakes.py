"""A distribution with small, fast sources and methods for tests of the benchmark."""

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tactile_loc.plugin import ComponentSpec, hookimpl, registry

MOVING = """\
import numpy as np
from tactile_loc_benchmark.interfaces import Method, ScoredPoses

class Moving(Method):
    def locate(self, problem, touches):
        return ScoredPoses(np.eye(4)[None], np.array([1.0]))
"""


@hookimpl
def tactile_loc_components() -> list[ComponentSpec]:
    """Return the components of bench_parts; the library of "library-source" and "library-method" does not exist."""
    sources = {"sketch": "Sketch", "photo": "Photo", "archive": "Archive"}
    methods = {"guess": "Guess", "oracle": "Oracle"}
    return [
        *(
            ComponentSpec("touch-source", name, f"bench_parts:{kind}", "made up", interface=2)
            for name, kind in sources.items()
        ),
        *(
            ComponentSpec("method", name, f"bench_parts:{kind}", "made up", interface=2)
            for name, kind in methods.items()
        ),
        ComponentSpec("touch-source", "library-source", "bench_missing:Source", "made up", "touch-maker", interface=2),
        ComponentSpec("method", "moving", "bench_moving:Moving", "made up", interface=2),
        ComponentSpec("method", "library-method", "bench_missing:Method", "made up", "touch-finder", interface=2),
    ]


def install(site: Path) -> Path:
    """Install the distribution into a folder for PYTHONPATH."""
    info = site / "bench_fakes-1.5.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-fakes\nVersion: 1.5\n")
    (info / "entry_points.txt").write_text("[tactile_loc]\nbench-fakes = bench_fakes\n")
    (site / "bench_missing.py").write_text("import nowhere_to_be_found\n")
    (site / "bench_moving.py").write_text(MOVING)
    return site


@contextmanager
def offer_fakes(site: Path) -> Iterator[None]:
    """Offer the components in this process and its children."""
    folders = [str(install(site)), str(Path(__file__).parent)]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folders[0])
        patch.setenv("PYTHONPATH", os.pathsep.join([*folders, os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))
        importlib.invalidate_caches()
        registry.cache_clear()
        yield
    registry.cache_clear()
