"""A third-party plugin is built and installed as a user does it; it is found, used, excluded and documented."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from message_helpers import missing

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "plugin"
GRID = ["--grid", "face", "-o", "grid.spacing_mm=8"]
RUN = ["run", "--object", "pin", "--refiner", "centroid", *GRID, "--seed", "3", "--top", "2"]


@pytest.fixture(scope="module")
def site(install_offline) -> Path:
    """The folder in which the example is installed."""
    return install_offline(EXAMPLE)


@pytest.fixture
def tactile_loc(site, tmp_path, run_python):
    """Run the command line in a new process that sees the installed plugin."""
    return partial(run_python, site, tmp_path, "-m", "tactile_loc_cli.main", TACTILE_LOC_STORE=str(tmp_path / "store"))


def test_an_installed_plugin_is_listed_with_its_distribution_and_options(tactile_loc):
    listed = tactile_loc("plugins", "refiner").stdout
    assert re.search(r"refiner +centroid +tactile-loc-centroid +\w", listed)
    assert re.search(r"refiner\.steps +int +4 +\w", tactile_loc("plugins", "refiner", "centroid").stdout)


@pytest.mark.slow
def test_the_plugin_refines_the_found_poses(tactile_loc, tmp_path):
    (tmp_path / "sure.toml").write_text("temperature = 0.1")  # the test needs no fitted temperature
    tactile_loc("simulate", "--object", "pin", "--grid", "face", "--count", "1", "--out", "touches")
    one = ("--touch", "touches/touch-0000.npz")  # several touches are refined together by the joint registration
    done = tactile_loc(*RUN, *one, "-o", "refiner.steps=2", "--config", "sure.toml", "--out", "out", "--store", "store")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["configuration"]["refiner"] == {"name": "centroid", "options": {"steps": 2}}
    assert result["distributions"]["refiner"] == "tactile-loc-centroid"
    found = result["hypotheses"]
    grid_poses, refined = (np.array([h[k] for h in found]) for k in ("T_sensor_object_grid", "T_sensor_object"))
    assert np.abs(grid_poses[:, :2, 3] - refined[:, :2, 3]).max() > 1e-5, "the refiner did not shift a pose"
    np.testing.assert_array_equal(grid_poses[:, :3, :3], refined[:, :3, :3], err_msg="the refiner changed the rotation")


@pytest.mark.slow
def test_an_environment_variable_excludes_or_includes_the_plugin(tactile_loc):
    refused = tactile_loc(*RUN, TACTILE_LOC_PLUGINS="")
    assert refused.returncode == 2
    assert refused.stderr.startswith("error: ")
    assert "'centroid'" in refused.stderr
    for name in ("centroid", "tactile-loc-centroid"):
        assert "centroid" in tactile_loc("plugins", "refiner", TACTILE_LOC_PLUGINS=name).stdout
    assert "centroid" not in tactile_loc("plugins", "refiner", TACTILE_LOC_PLUGINS="another").stdout


@pytest.mark.slow
def test_a_misspelt_option_of_the_plugin_gives_a_one_sentence_error(tactile_loc):
    refused = tactile_loc(*RUN, "-o", "refiner.step=2")
    assert refused.returncode == 2
    assert not missing(refused.stderr, "refiner 'centroid'", "'step'", "'steps'")
    assert "Traceback" not in refused.stderr


@pytest.mark.slow
def test_a_broken_plugin_is_listed_and_does_not_affect_others(tactile_loc, site):
    package = site / "tactile_loc_centroid" / "__init__.py"
    text = package.read_text()
    package.write_text("import a_library_that_is_not_there\n")
    try:
        listed = tactile_loc("plugins")
        assert not missing(listed.stdout + listed.stderr, "tactile-loc-centroid", "ModuleNotFoundError")
        assert re.search(r"refiner +icp", listed.stdout)
        assert "a_library_that_is_not_there" in tactile_loc(*RUN).stderr
    finally:
        package.write_text(text)


@pytest.mark.slow
def test_the_plugins_own_tests_pass(site, run_own_tests):
    said = run_own_tests(site, {"centroid": EXAMPLE / "tests"})
    assert re.search(r"^=+ \d\d passed", said, re.MULTILINE), said
    assert not re.search("^(FAILED|ERROR) ", said, re.MULTILINE), said
