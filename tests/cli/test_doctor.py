"""doctor reports working and broken parts, and never raises."""

import dataclasses
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import HANGS_S
from message_helpers import missing
from PIL import Image
from tactile_loc_cli.doctor import checks
from tactile_loc_cli.doctor.checks import LIBRARIES, Dependency, State, attempt, examine

from tactile_loc import __version__
from tactile_loc.slots import registry as registry_module
from tactile_loc.slots.registry import LoadFailure, Registry

SCRIPT = Path(__file__).parents[2] / "scripts" / "system-packages.sh"
FEW = tuple(library for library in LIBRARIES if library.module in ("numpy", "numba", "open3d", "pyrender"))


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Raise the time limit of trials, since a machine may be busy."""
    monkeypatch.setattr(checks, "TIMEOUT_S", HANGS_S)


@pytest.fixture
def libraries(monkeypatch):
    """Choose the libraries to check."""
    return lambda *chosen: monkeypatch.setattr(checks, "LIBRARIES", chosen)


@pytest.mark.slow
def test_working_parts_are_reported_as_ok(cli, libraries, tmp_path):
    libraries(*FEW)
    done = cli("doctor", "--json", "--store", tmp_path / "store")
    found = json.loads(done.stdout)
    named = {check["name"]: check for check in found["checks"]}
    assert named["tactile-loc"]["version"] == __version__
    assert named["machine"]["cores"] >= 1
    assert named["machine"]["memory_bytes"] > 1e8
    for name in ("numpy", "numba", "open3d", "plugins", "store"):
        assert named[name]["state"] == "ok", named[name]
    assert named["plugins"]["components"] >= 7
    assert named["store"]["bytes"] == 0
    assert named["store"]["free_bytes"] > 0
    assert (done.exit_code, found["ready"], found["broken"]) == (0, True, [])
    assert not (tmp_path / "store").exists()


ABSENT = Dependency("no_such_module_here", ("no-such-thing",), "the renderer nobody", "pip install no-such-thing")


def test_a_missing_library_is_named_with_its_install_command(cli, libraries, tmp_path):
    libraries(ABSENT)
    done = cli("doctor")
    (line,) = [line for line in done.stdout.splitlines() if "no_such_module_here" in line]
    assert line.split()[0] == "missing"
    assert "the renderer nobody" in line
    assert line.endswith("pip install no-such-thing")
    assert done.exit_code == 0


def test_only_a_missing_required_library_is_an_error(cli, libraries):
    libraries(dataclasses.replace(ABSENT, required=True))
    plain, done = cli("doctor"), cli("doctor", "--json")
    assert (plain.exit_code, done.exit_code) == (1, 1)
    assert "no_such_module_here" in plain.stdout.splitlines()[-1]
    assert (plain.stderr, done.stderr) == ("", "")
    found = json.loads(done.stdout)
    assert (found["ready"], found["broken"]) == (False, ["no_such_module_here"])


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return a function that writes a module where the trials import it."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    (tmp_path / "site").mkdir()

    def write(body: str) -> str:
        (tmp_path / "site" / "brittle_thing.py").write_text(body)
        return "brittle_thing"

    return write


@pytest.mark.parametrize(
    ("body", "failure"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "SIGSEGV"),
        ("import os; os.abort()", "SIGABRT"),
        ("raise RuntimeError('out of order')", "RuntimeError: out of order"),
        ("raise SystemExit(3)", "code 3"),
        ("import os; os._exit(0)", "nothing"),
    ],
)
def test_each_kind_of_import_failure_is_reported(module, body, failure):
    assert failure in attempt("import", module(body)).failure


@pytest.mark.slow
def test_a_hanging_library_is_stopped(module):
    assert attempt("import", module("import signal; signal.pause()"), timeout_s=2).failure.endswith("2 s")


def test_a_library_that_fails_to_load_names_the_system_package(cli, libraries, module, monkeypatch):
    name = module("raise ImportError('libusb-1.0.so.0: cannot open shared object file: No such file or directory')")
    monkeypatch.setattr(checks.shutil, "which", lambda _: "/usr/bin/apt-get")
    libraries(Dependency(name, ("numpy",), "tests", "pip install numpy", True))
    done = cli("doctor", "--json")
    (check,) = [check for check in json.loads(done.stdout)["checks"] if check["name"] == name]
    assert (check["state"], check["remedy"]) == ("broken", "sudo apt-get install libusb-1.0-0")
    assert "libusb-1.0.so.0" in check["says"]
    assert done.exit_code == 1


@pytest.mark.slow
def test_missing_egl_names_the_packages_and_is_not_fatal(cli, libraries, monkeypatch):
    monkeypatch.setenv("PYOPENGL_PLATFORM", "no-such-platform")
    libraries(*(library for library in FEW if library.module == "pyrender"))
    done = cli("doctor")
    (line,) = [line for line in done.stdout.splitlines() if " pyrender " in line and line.startswith("broken")]
    assert not missing(line, "no-such-platform", "libegl1", "libgl1-mesa-dri")
    assert done.exit_code == 0


def test_a_library_that_prints_is_no_failure_and_the_working_folder_is_not_searched(cli, module):
    assert attempt("import", module("print('chatter')")).failure == ""
    Path("numpy.py").write_text("raise RuntimeError('not numpy')")
    assert attempt("import", "numpy").failure == ""


def test_broken_checks_do_not_stop_the_doctor(monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("broken")

    for name in ("_check_versions", "_check_machine", "_check_plugins", "_check_store", "check_shared_libraries"):
        monkeypatch.setattr(checks, name, fail)
    monkeypatch.setattr(checks, "attempt", fail)
    found = examine(None)
    assert {check.state for check in found} == {State.BROKEN}
    assert {"store", "plugins", "numpy"} <= {check.name for check in found if check.is_fatal}


def test_plugins_that_failed_to_load_are_named_and_not_fatal(cli, libraries, monkeypatch):
    libraries()
    found = Registry([])
    found.offers += registry_module.registry().offers
    found.failures.append(LoadFailure("broken-one", "broken-package", "ValueError: out of order"))
    monkeypatch.setattr(registry_module, "registry", lambda: found)
    done = cli("doctor")
    (line,) = [line for line in done.stdout.splitlines() if "broken-one" in line]
    assert line.startswith("broken ")
    assert not missing(line, "broken-package", "ValueError: out of order")
    assert done.exit_code == 0


def test_an_unwritable_store_and_missing_built_in_components_are_fatal(cli, libraries, monkeypatch):
    libraries()
    Path("file").write_text("mine")
    done = cli("doctor", "--store", "file/store")
    assert done.exit_code == 1
    assert not missing(done.stdout, "TACTILE_LOC_STORE", "--store")
    monkeypatch.setattr(registry_module, "registry", lambda: Registry([]))
    assert cli("doctor").exit_code == 1


@pytest.mark.skipif(sys.platform != "linux", reason="the check is for Linux")
def test_missing_shared_libraries_are_named_with_their_packages(monkeypatch):
    monkeypatch.setattr(checks, "PACKAGES", {"libabsent.so.7": "libabsent7", "libc.so.6": "libc6"})
    monkeypatch.setattr(checks, "find_spec", lambda name: None)
    assert list(checks.check_shared_libraries()) == [], "without open3d and pyrender, none is needed"
    monkeypatch.setattr(checks, "find_spec", lambda name: name)
    monkeypatch.setattr(checks.shutil, "which", lambda _: None)
    (check,) = [check for check in checks.check_shared_libraries() if check.name.startswith("lib")]
    assert (check.name, check.state) == ("libabsent.so.7", State.MISSING)
    assert "libabsent7" in check.remedy
    assert not check.is_fatal


def test_the_package_table_matches_the_script():
    text = SCRIPT.read_text()
    table = re.search(r'libraries="\n(.*?)\n"', text, re.DOTALL)
    assert dict(line.split() for line in table[1].splitlines()) == dict(checks.PACKAGES)
    assert re.search(rf'miss "[^"]*EGL[^"]*" {re.escape(checks.DRIVER)}', text)


def test_the_compile_option_compiles_the_kernels(cli, libraries, monkeypatch, tmp_path):
    libraries()
    asked = []

    def tried(trial, *words, timeout_s=None):
        asked.append(trial)
        return checks.Attempt({"says": "compiled", "seconds": 9.5}, "")

    monkeypatch.setattr(checks, "attempt", tried)
    plain, compiled = (json.loads(cli("doctor", "--json", *more).stdout)["checks"] for more in ([], ["--compile"]))
    assert "kernels" not in {check["name"] for check in plain}
    (found,) = [check for check in compiled if check["name"] == "kernels"]
    assert (found["state"], found["seconds"], asked.count("kernels")) == ("ok", 9.5, 1)


@pytest.mark.slow
def test_the_kernels_of_locating_compile():
    outcome = checks.attempt("kernels", timeout_s=300)
    assert not outcome.failure
    assert outcome.facts["seconds"] > 0


def test_photos_need_a_sensor_and_a_sensor_needs_photos(cli, tmp_path):
    assert cli("doctor", "photo.png").exit_code == 2
    assert cli("doctor", "--sensor", tmp_path / "none").exit_code == 2


@pytest.mark.slow
def test_a_sensor_is_checked_and_its_page_is_written(cli, tmp_path):
    from press_sets import ball_set, write_image

    few = ("--option", "steps=400", "--option", "hidden=16", "--store", tmp_path / "store")
    presses, photos = ball_set(15, px=80).write(tmp_path / "presses"), tmp_path / "photos"
    assert cli("calibrate", presses, *few, "--out", tmp_path / "mine").exit_code == 0
    photos.mkdir()
    for number, image in enumerate(ball_set(6, px=80, seed=7).images):
        write_image(photos / f"{number}.png", image)
    words = ("doctor", "--sensor", tmp_path / "mine", photos, "--store", tmp_path / "store", "--json")
    done = cli(*words, "--out", tmp_path / "clean")
    assert (done.exit_code, json.loads(done.stdout)["faults"]) == (0, {})
    for path in photos.iterdir():
        write_image(path, np.asarray(Image.open(path))[::-1])
    done = cli(*words, "--out", tmp_path / "turned")
    found = json.loads(done.stdout)
    assert done.exit_code == 1
    assert [*found["faults"]] == ["order of colours and pixels"]
    assert found["pose_errors_m"]["order of colours and pixels"] > 1e-3
    assert "top and bottom" in (tmp_path / "turned" / "passport.html").read_text()
    assert cli("doctor", "--sensor", tmp_path / "mine", photos / "0.png").exit_code == 2
