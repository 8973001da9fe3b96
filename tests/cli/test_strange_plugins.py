"""Third-party plugins: missing libraries, failures, and equal names."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_helpers import TINY, assert_one_error
from message_helpers import missing

HOOK = """
from tactile_loc.slots.registry import ComponentSpec, hookimpl

@hookimpl
def tactile_loc_components():
    return [ComponentSpec("refiner", {name!r}, "{module}_parts:Part", "made up", {requires!r}, interface=2)]
"""


@pytest.fixture
def install(tmp_path: Path):
    """Return a function that installs an invented distribution into a folder for PYTHONPATH."""
    site = tmp_path / "site"

    def add(distribution: str, hook: str, parts: str = "") -> str:
        module = distribution.replace("-", "_")
        info = site / f"{module}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[tactile_loc]\n{distribution} = {module}\n")
        (site / f"{module}.py").write_text(hook)
        (site / f"{module}_parts.py").write_text(parts)
        return str(site)

    return add


def hook(name: str, module: str, requires: str = "") -> str:
    return HOOK.format(name=name, module=module, requires=requires)


def test_a_missing_library_is_reported_with_its_install_command(install, run_process):
    site = install("far-away", hook("far", "far_away", "faraway-lib"), "import faraway")
    assert "refiner far far-away" in " ".join(run_process("plugins", PYTHONPATH=site).stdout.split())
    done = run_process("run", *TINY, "--refiner", "far", PYTHONPATH=site)
    assert_one_error(done.stderr, done.returncode, "'far'", "faraway", "pip install faraway-lib")


def test_a_failing_plugin_matters_only_when_it_is_chosen(install, run_process):
    site = install("broken-one", "raise RuntimeError('out of order')")
    listed = run_process("plugins", PYTHONPATH=site)
    assert listed.returncode == 0
    assert "icp" in listed.stdout
    (line,) = [line for line in listed.stdout.splitlines() if "broken-one" in line]
    assert "RuntimeError: out of order" in line
    done = run_process("run", *TINY, "--refiner", "broken", PYTHONPATH=site)
    assert_one_error(done.stderr, done.returncode, "'broken'", "out of order")


def test_a_component_that_fails_on_import_is_one_sentence(install, run_process):
    site = install("half-broken", hook("half", "half_broken"), "1 / 0")
    done = run_process("run", *TINY, "--refiner", "half", PYTHONPATH=site)
    assert_one_error(done.stderr, done.returncode, "'half'", "half-broken", "ZeroDivisionError")


def test_a_name_conflict_names_both_distributions(install, run_process):
    install("first-twin", hook("twin", "first_twin"), "")
    site = install("second-twin", hook("twin", "second_twin"), "")
    done = run_process("run", *TINY, "--refiner", "twin", PYTHONPATH=site)
    assert_one_error(done.stderr, done.returncode, "first-twin", "second-twin")
    listed = run_process("plugins", PYTHONPATH=site)
    assert not missing(listed.stdout, "refiner 'twin'", "first-twin", "second-twin")
    alone = run_process("plugins", "refiner", PYTHONPATH=site, TACTILE_LOC_PLUGINS="first-twin")
    assert "first-twin" in alone.stdout
    assert "second-twin" not in alone.stdout


@pytest.mark.slow
def test_missing_egl_is_reported_with_another_renderer(run_process):
    done = run_process("run", *TINY, "--renderer", "pyrender", "--out", "out", PYOPENGL_PLATFORM="no-such-platform")
    assert_one_error(done.stderr, done.returncode, "pyrender", "--renderer heightmap")
