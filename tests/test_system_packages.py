"""The check of the system libraries, with a missing library and stand-ins for package managers."""

import _ctypes
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


@pytest.mark.parametrize(("uid", "sudo"), [(0, 0), (1000, 3)], ids=["root", "passwordless sudo"])
def test_exactly_the_missing_packages_are_installed(system, uid, sudo):
    system.lose_library()
    system.user(uid)
    system.apt(installs=f'ln -s "{_ctypes.__file__}" "{system.folder}/lib/libabsent.so.7"')
    system.command("sudo", f'echo sudo >> "{system.log}"; shift; exec "$@"')
    result = system.run()
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("\n") == 1
    assert not missing(result.stdout, "libusb-1.0-0")
    assert system.apt_calls.count("sudo") == sudo  # permission check, update, install
    update, install = [call for call in system.apt_calls if call != "sudo"]
    assert "update" in update
    assert install == "noninteractive apt-get -qq install -y --no-install-recommends libusb-1.0-0"


@pytest.mark.parametrize(
    ("uid", "installs", "message"),
    [
        (0, None, "libabsent.so.7"),
        (0, "exit 100", "apt-get could not install"),
        (0, ":", "Still missing"),
        (1000, ":", "sudo apt-get install -y libusb-1.0-0\n"),
    ],
    ids=["no apt", "a failed installation", "a useless installation", "a user without rights"],
)
def test_a_library_that_stays_missing_is_an_error(system, uid, installs, message):
    system.lose_library()
    system.user(uid)
    system.command("sudo", "exit 1")
    if installs:
        system.apt(installs)
    result = system.run()
    assert result.returncode == 1
    assert message in result.stderr
    assert not missing(result.stderr, "libusb-1.0-0" if installs and uid == 0 else "libabsent.so.7")
    assert uid == 0 or system.apt_calls == []


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


@pytest.mark.parametrize(
    ("given", "advice"),
    [({}, ["apt-get install python3.11 python3.11-venv"]), ({"PYTHON": "python-old"}, ["python-old", 3.11])],
)
def test_a_missing_or_old_python_is_refused(system, given, advice):
    for name in ("python3.11", "python3", "python-old"):
        system.command(name, "exit 1")
    result = system.run("find-python.sh", **given)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert not missing(result.stderr, *advice)
