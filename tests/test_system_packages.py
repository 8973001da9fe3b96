"""The check of the system libraries, with a missing library and stand-ins for package managers."""

from __future__ import annotations

import _ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from message_helpers import missing

SCRIPTS = Path(__file__).parents[1] / "scripts"
TOOLS = ("sh", "env", "dirname", "uname", "ln", "cat", "true")

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the check is for Linux")


class PretendedSystem:
    """A folder of commands that is the whole PATH, so that nothing real can be installed."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.log = folder, folder / "log"
        for name in ("bin", "lib", "scripts"):
            (folder / name).mkdir()
        for tool in TOOLS:
            (folder / "bin" / tool).symlink_to(shutil.which(tool))
        for script in SCRIPTS.glob("*.sh"):
            shutil.copy(script, folder / "scripts")
        self.command("python3.11", f'exec "{sys.executable}" "$@"')

    def command(self, name: str, body: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(f"#!/bin/sh\n{body}\n")
        path.chmod(0o755)

    def user(self, uid: int) -> None:
        self.command("id", f"echo {uid}")

    def apt(self, installs: str = ":") -> None:
        """Add an apt-get that logs its calls and runs `installs` on an install command."""
        log = f'echo "$DEBIAN_FRONTEND apt-get $*" >> "{self.log}"'
        self.command("apt-get", f'{log}\ncase "$*" in *install*) {installs};; esac')

    def lose_library(self) -> None:
        """Let the script look for a library that no system has instead of libusb."""
        script = self.folder / "scripts" / "system-packages.sh"
        script.write_text(script.read_text().replace("libusb-1.0.so.0 ", "libabsent.so.7 "))

    def run(self, script: str = "system-packages.sh", *words: str, **env: str) -> subprocess.CompletedProcess[str]:
        path = {"PATH": str(self.folder / "bin"), "LD_LIBRARY_PATH": str(self.folder / "lib")}
        command = [str(self.folder / "scripts" / script), *words]
        return subprocess.run(command, env=path | env, capture_output=True, text=True, check=False)

    @property
    def apt_calls(self) -> list[str]:
        return self.log.read_text().splitlines() if self.log.exists() else []


@pytest.fixture
def system(tmp_path: Path) -> PretendedSystem:
    return PretendedSystem(tmp_path)


def test_a_complete_system_installs_nothing(system):
    system.apt()
    result = system.run()
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("\n") == 1
    assert "libusb" not in result.stdout
    assert system.apt_calls == []


def test_root_installs_exactly_the_missing_packages(system):
    system.lose_library()
    system.user(0)
    system.apt(installs=f'ln -s "{_ctypes.__file__}" "{system.folder}/lib/libabsent.so.7"')
    result = system.run()
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("\n") == 1
    assert not missing(result.stdout, "libusb-1.0-0")
    update, install = system.apt_calls
    assert "update" in update
    assert install == "noninteractive apt-get -qq install -y --no-install-recommends libusb-1.0-0"


def test_passwordless_sudo_is_used(system):
    system.lose_library()
    system.user(1000)
    system.apt(installs=f'ln -s "{_ctypes.__file__}" "{system.folder}/lib/libabsent.so.7"')
    system.command("sudo", f'echo sudo >> "{system.log}"; shift; exec "$@"')
    assert system.run().returncode == 0
    assert system.apt_calls.count("sudo") == 3  # calls: permission check, update, install


def test_a_user_without_rights_is_told_the_command(system):
    system.lose_library()
    system.user(1000)
    system.apt()
    system.command("sudo", "exit 1")
    result = system.run()
    assert result.returncode == 1
    assert "libabsent.so.7" in result.stderr
    assert result.stderr.endswith("sudo apt-get install -y libusb-1.0-0\n")
    assert system.apt_calls == []


def test_a_missing_library_is_named_without_apt(system):
    system.lose_library()
    system.user(0)
    result = system.run()
    assert result.returncode == 1
    assert not missing(result.stderr, "libabsent.so.7")


@pytest.mark.parametrize(("installs", "message"), [("exit 100", "apt-get could not install"), (":", "Still missing")])
def test_a_failed_or_useless_installation_is_an_error(system, installs, message):
    system.lose_library()
    system.user(0)
    system.apt(installs)
    result = system.run()
    assert result.returncode == 1
    assert message in result.stderr
    assert "libusb-1.0-0" in result.stderr


BROWSER = ("chromium", "chromedriver")


def for_tests(system: PretendedSystem) -> str:
    """The output of the search for the tests' browser, which always succeeds."""
    result = system.run("system-packages.sh", "--tests")
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_an_installed_browser_is_not_installed_again(system):
    system.apt()
    system.user(0)
    for name in BROWSER:
        system.command(name, ":")
    (line,) = for_tests(system).splitlines()
    assert "browser" in line
    assert system.apt_calls == []


@pytest.mark.parametrize("there", [(), BROWSER[:1], BROWSER[1:]])
def test_root_installs_the_missing_parts_of_the_browser(system, there):
    for name in there:
        system.command(name, ":")
    system.user(0)
    makes = [f'ln -sf "{system.folder}/bin/id" "{system.folder}/bin/{name}"' for name in BROWSER]
    system.apt(installs="; ".join(makes))
    assert "browser" in for_tests(system).splitlines()[-1]
    update, install = system.apt_calls
    assert "update" in update
    assert install == "noninteractive apt-get -qq install -y --no-install-recommends chromium chromium-driver"


@pytest.mark.parametrize(("uid", "installs"), [(1000, ":"), (0, "exit 100"), (0, ":")])
def test_a_missing_browser_only_skips_its_tests(system, uid, installs):
    system.user(uid)
    system.apt(installs)
    system.command("sudo", "exit 1")
    system.command("python3.11", "exit 1")  # Python is not searched for either
    assert re.search(r"skipped.*chromium chromium-driver\n", for_tests(system))


def test_other_systems_than_debian_skip_the_browser(system):
    system.user(0)
    assert "skipped" in for_tests(system)


def without_venv(system: PretendedSystem, marker: Path) -> str:
    """A Python that cannot make virtual environments until `marker` exists."""
    return (
        f'case "$2" in *ensurepip*) [ -e "{marker}" ]; exit;; *_base_executable*) echo "$0"; exit;; esac\n'
        f'exec "{sys.executable}" "$@"'
    )


def test_the_venv_module_is_installed_for_the_python_that_lacks_it(system):
    marker = system.folder / "lib" / "venv"
    system.command("python3.11", without_venv(system, marker))
    system.user(0)
    system.apt(installs=f'ln -s . "{marker}"')
    result = system.run()
    assert result.returncode == 0, result.stderr
    assert system.apt_calls[-1].endswith(f"python3.{sys.version_info.minor}-venv")


def test_a_python_that_makes_virtual_environments_is_preferred(system):
    system.command("python3.11", without_venv(system, system.folder / "never"))
    system.command("python3.12", f'exec "{sys.executable}" "$@"')
    assert system.run("find-python.sh").stdout.strip() == os.path.realpath(sys._base_executable)


def test_a_missing_python_is_reported_with_the_install_command(system):
    for name in ("python3.11", "python3"):
        system.command(name, "exit 1")
    result = system.run("find-python.sh")
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "apt-get install python3.11 python3.11-venv" in result.stderr


def test_a_named_python_that_is_too_old_is_refused(system):
    system.command("python-old", "exit 1")
    result = system.run("find-python.sh", PYTHON="python-old")
    assert result.returncode == 1
    assert not missing(result.stderr, "python-old", 3.11)
