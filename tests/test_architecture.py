"""Imports between packages point to lower layers without cycles, and docs/architecture.md matches the code."""

import ast
from pathlib import Path

import packages
import pytest

ROOT = Path(__file__).parents[1]
# The modules that a built-in component may import besides the front door and its own subpackage.
ALLOWED = {
    "tactile_loc.plugins.sensors.calibrated": {
        "tactile_loc.sensors.calibration.folder",
        "tactile_loc.sensors.reading.reading",
    },
    "tactile_loc.plugins.sensors.file": {"tactile_loc.io.sensor_files"},
}
FRONT_DOOR = {"tactile_loc", "tactile_loc.plugin", "tactile_loc.plugin.helpers"}
SLOTS = ("encoders", "fusers", "grids", "matchers", "refiners", "renderers", "sensors")
FILE_ACCESS = {
    "open", "read_text", "read_bytes", "write_text", "write_bytes", "load", "save", "savez", "fromfile", "tofile",
    "loadtxt", "savetxt", "mkdir", "unlink", "rename", "replace_file", "rmtree", "memmap", "NamedTemporaryFile",
}  # fmt: skip

UNIX_MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"}
UNIX_NAMES = {
    *(f"os.{name}" for name in (
        "O_DIRECTORY", "O_NOFOLLOW", "fork", "forkpty", "geteuid", "getloadavg", "getuid", "killpg", "mkfifo", "pread",
        "pwrite", "sched_getaffinity", "setsid", "statvfs", "sysconf", "uname", "wait", "waitpid",
    )),
    *(f"signal.{name}" for name in ("SIGALRM", "SIGHUP", "SIGKILL", "SIGUSR1", "alarm", "pause", "setitimer")),
}  # fmt: skip
# What is used only where the system has it.
GUARDED = {
    "tactile_loc/store/locks.py": {"os.O_DIRECTORY"},
    "tactile_loc/evaluation/workers.py": {"os.sched_getaffinity"},
    "tactile_loc/io/streams/cameras.py": {"/dev/v4l/by-id"},
    "plugins_contrib/tactile-loc-app/tactile_loc_app/chosen_camera.py": {"/dev/"},
}
CORE_FILE_ACCESS = {
    "code_cache.py": {"mkdir", "read_bytes", "rmtree"}  # compiled code
}


@pytest.fixture(scope="module")
def ours() -> list:
    """The imports between the project's own modules."""
    return [found for found in packages.imports() if packages.is_ours(found.imported)]


def test_every_package_has_a_layer():
    assert {packages.package(module) for module in packages.modules()} == set(packages.LAYER_OF)


def test_late_and_type_checking_imports_are_found(tmp_path):
    types = "if TYPE_CHECKING:\n    from tactile_loc.io import toml\n"
    (tmp_path / "some.py").write_text(f"{types}def late():\n    import tactile_loc.core.poses.metric.metric, numpy\n")
    seen = {(i.line, i.imported) for i in packages._imports_of("some", tmp_path / "some.py")}
    assert seen == {(2, "tactile_loc.io.toml"), (4, "tactile_loc.core.poses.metric.metric"), (4, "numpy")}


def test_packages_import_only_lower_layers(ours):
    def climbs(found) -> bool:
        start, end = packages.package(found.importer), packages.package(found.imported)
        return start != end and packages.LAYER_OF[end] >= packages.LAYER_OF[start]

    assert "\n".join(str(found) for found in ours if climbs(found)) == ""


def test_no_module_imports_itself_through_others(ours):
    direct: dict[str, set[str]] = {module: set() for module in packages.modules()}
    for found in ours:
        direct[found.importer].add(found.imported)

    def reached(module: str) -> set[str]:
        found, waiting = set(), list(direct[module])
        while waiting:
            if (name := waiting.pop()) not in found:
                found.add(name)
                waiting.extend(direct[name])
        return found

    circular = {module for module in direct if module in reached(module)}
    links = [f for f in ours if f.importer in circular and f.importer in {*reached(f.imported), f.imported}]
    assert "\n".join(map(str, links)) == ""


def test_the_plugin_module_imports_no_other_package():
    assert packages.packages_imported()["plugin"] == ["bases", "simulate", "slots", "core"]


def test_core_imports_no_rendering_or_learning_library():
    assert not {"torch", "open3d", "pyrender", "matplotlib", "faiss"} & set(packages.libraries_imported()["core"])


def find_unportable(tree: ast.AST) -> set[str]:
    """Return the modules, functions and paths that a source uses and that Windows does not have."""
    nodes = list(ast.walk(tree))
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    used = {f"{node.value.id}.{node.attr}" for node in nodes if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)}  # fmt: skip
    texts = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    paths = {text for text in texts if text.startswith(("/proc", "/dev/", "/tmp", "/sys/"))}
    return imported & UNIX_MODULES | used & UNIX_NAMES | paths


def test_only_guarded_modules_use_what_windows_does_not_have():
    sources = [path for folder in ("tactile_loc", "cli", "plugins_contrib") for path in (ROOT / folder).rglob("*.py")]
    found = {path: find_unportable(ast.parse(path.read_text("utf-8"))) for path in sources if "tests" not in path.parts}
    assert {path.relative_to(ROOT).as_posix(): names for path, names in found.items() if names} == GUARDED
    assert find_unportable(ast.parse("import fcntl\nos.fork()\nopen('/proc/meminfo')\nkill(signal.SIGKILL)")) == {
        "fcntl", "os.fork", "/proc/meminfo", "signal.SIGKILL"
    }  # fmt: skip


def test_core_accesses_no_files():
    for path in sorted((ROOT / "tactile_loc" / "core").rglob("*.py")):
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        names = {getattr(call.func, "attr", getattr(call.func, "id", "")) for call in calls}
        assert names & FILE_ACCESS <= CORE_FILE_ACCESS.get(path.name, set()), path


@pytest.mark.parametrize("slot", SLOTS)
def test_built_in_components_import_only_the_public_interface(slot, ours):
    start = f"tactile_loc.plugins.{slot}."
    here = [found for found in ours if found.importer.startswith(start)]
    assert here
    for found in here:
        own = start + found.importer.removeprefix(start).partition(".")[0]
        allowed = FRONT_DOOR | ALLOWED.get(found.importer, set())
        assert found.imported in allowed or f"{found.imported}.".startswith(f"{own}."), str(found)


def test_the_package_table_matches_the_imports():
    page = packages.PAGE.read_text()
    paths = [match["path"] for match in packages.ROW.finditer(page)]
    assert sorted(map(packages.package_at, paths)) == sorted(packages.LAYER_OF), "a row for each package"
    assert all((ROOT / path).exists() for path in paths)
    assert page == packages.with_table(page), "run python docs/packages.py"


def test_the_package_picture_matches_the_imports():
    assert packages.PICTURE.read_text() == packages.picture(), "run python docs/packages.py"
    assert f"images/{packages.PICTURE.name}" in packages.PAGE.read_text()
