"""The checks of doctor. Trials that may crash or hang run in separate processes."""

import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psutil

from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc_cli.console import format_count


class State(StrEnum):
    """The state that a check found."""

    OK = "ok"
    MISSING = "missing"
    BROKEN = "broken"


@dataclass(frozen=True)
class Diagnosis:
    """A finding. `says` describes it, `remedy` advises what to do, and `facts` are JSON values in SI units."""

    name: str
    state: State
    says: str
    remedy: str = ""
    required: bool = False
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_fatal(self) -> bool:
        """Whether tactile-loc cannot work because of this finding."""
        return self.required and self.state is not State.OK

    def record(self) -> dict[str, Any]:
        """Return the finding as JSON values."""
        text = {"says": self.says, "remedy": self.remedy, "required": self.required}
        return {"name": self.name, "state": str(self.state), **text, **self.facts}


@dataclass(frozen=True)
class Probe:
    """A function `look` that returns findings. It may raise any exception."""

    name: str
    look: Callable[[], Iterable[Diagnosis]]
    required: bool = False

    def run(self) -> list[Diagnosis]:
        """Return the findings. If `look` fails, return its failure as the finding."""
        try:
            return list(self.look())
        except TactileLocError as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001 - a broken library may raise anything, and other probes must run
            reason = f"{type(error).__name__}: {error}"
        return [Diagnosis(self.name, State.BROKEN, reason, required=self.required)]


TIMEOUT_S = 90.0
COMPILE_S = 600.0
LONGEST = 240  # shown characters of a reason


@dataclass(frozen=True)
class Attempt:
    """The outcome of a trial: the facts that it found, or the reason why it failed."""

    facts: dict[str, Any] = field(default_factory=dict)
    failure: str = ""


def attempt(trial: str, *words: str, timeout_s: float | None = None) -> Attempt:
    """Run a trial of `trials.py`, by default for at most TIMEOUT_S seconds, and return its outcome. Never raises."""
    timeout_s = TIMEOUT_S if timeout_s is None else timeout_s
    # -P: do not import files of the current folder in place of libraries
    line = [sys.executable, "-P", "-m", "tactile_loc_cli.doctor.trials", trial, *words]
    try:
        done = subprocess.run(
            line, capture_output=True, text=True, errors="replace", timeout=timeout_s, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        return Attempt(failure=f"no answer within {timeout_s:g} s")
    except OSError as error:
        return Attempt(failure=f"Python cannot be started ({error.strerror})")
    if done.returncode < 0:
        return Attempt(failure=f"it crashed ({_name_signal(-done.returncode)})")
    if done.returncode > 0:
        return Attempt(failure=_read_last_line(done.stderr)[:LONGEST] or f"it exited with code {done.returncode}")
    try:
        return Attempt(facts=dict(json.loads(_read_last_line(done.stdout))))
    except (ValueError, TypeError):
        return Attempt(failure="it printed nothing readable")


def _name_signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _read_last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else ""


# a test compares these pairs with scripts/system-packages.sh
PACKAGES: Mapping[str, str] = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
    "libgomp.so.1": "libgomp1",
}
USERS: Mapping[str, str] = {"libEGL.so.1": "the renderer pyrender"}  # open3d uses all others
DRIVER = "libgl1-mesa-dri"  # Mesa's drivers, which need no GPU
DRIVER_PATTERNS = ("lib/dri/*_dri.so", "lib64/dri/*_dri.so", "lib/*/dri/*_dri.so", "lib/*/libgallium-*.so")


def check_shared_libraries() -> Iterator[Diagnosis]:
    """Find missing shared libraries of open3d and pyrender, if one of them is installed. Only Linux is checked."""
    users = [name for name in ("open3d", "pyrender") if find_spec(name) is not None]
    if sys.platform != "linux" or not users:
        return
    outcome = attempt("shared-libraries", *PACKAGES)
    if outcome.failure:
        yield Diagnosis("system libraries", State.BROKEN, outcome.failure)
        return
    for library in outcome.facts["missing"]:
        user = USERS.get(library, "open3d")
        yield Diagnosis(library, State.MISSING, f"{user} needs it", advise_install(PACKAGES[library]))
    if not has_egl_driver():
        remedy = advise_install(DRIVER)
        yield Diagnosis("EGL driver", State.MISSING, "the renderer pyrender needs one, Mesa's or NVIDIA's", remedy)
    if not outcome.facts["missing"]:
        yield Diagnosis("system libraries", State.OK, "all found")


def has_egl_driver() -> bool:
    """Return whether an EGL driver is installed, because libEGL alone cannot render."""
    if not attempt("shared-libraries", "libEGL_nvidia.so.0").facts.get("missing", True):
        return True
    return any(found for pattern in DRIVER_PATTERNS for found in Path("/usr").glob(pattern))


def advise_install(package: str) -> str:
    """Return how to install a Debian package on this system."""
    if shutil.which("apt-get"):
        return f"sudo apt-get install {package}"
    return f"install the equivalent of the Debian package {package}"


def find_remedy(failure: str, otherwise: str) -> str:
    """Return how to install the shared library that a failure names, or `otherwise` if it names no library."""
    return next((advise_install(package) for library, package in PACKAGES.items() if library in failure), otherwise)


PYTHON = (3, 11)
LITTLE_DISK_B = 2e9
LOW_DISK = "too little for models of large grids, which take gigabytes"


@dataclass(frozen=True)
class Dependency:
    """A library. `module` is imported, `distributions` are its possible names for pip, and `serves` says what needs it.

    `install` is the advice for a missing library.
    """

    module: str
    distributions: tuple[str, ...]
    serves: str
    install: str
    required: bool = False
    trial: str = "import"
    repair: str = ""  # advice for a library that is installed but does not work; default: reinstall it


def _require(module: str, *distributions: str, trial: str = "import", serves: str = "") -> Dependency:
    names = distributions or (module,)
    return Dependency(module, names, serves or "needed by everything", f"pip install {names[0]}", True, trial)


LIBRARIES = (
    _require("numpy"),
    _require("scipy"),
    _require("numba", trial="numba"),
    _require("trimesh"),
    _require("fast_simplification", "fast-simplification", serves="results of large meshes"),
    _require("matplotlib"),
    _require("PIL", "pillow"),
    _require("jinja2", serves="reports"),
    _require("safetensors", serves="learned models"),
    Dependency("faiss", ("faiss-cpu", "faiss-gpu"), "the matcher faiss", "pip install 'tactile-loc[faiss]'"),
    Dependency(
        "open3d",
        ("open3d-cpu", "open3d"),
        "the renderer raycast and the refiner icp",
        "pip install 'tactile-loc[render]'",
        trial="open3d",
    ),
    Dependency(
        "pyrender",
        ("pyrender",),
        "the renderer pyrender",
        "pip install 'tactile-loc[render]'",
        trial="egl",
        repair=advise_install("libegl1 libgl1-mesa-dri"),
    ),
    Dependency("torch", ("torch",), "the encoder moco", "pip install 'tactile-loc[learned]'", trial="torch"),
    Dependency("kiss_icp", ("kiss-icp",), "the refiner kiss-icp", "pip install 'tactile-loc[kiss]'"),
    Dependency("small_gicp", ("small-gicp",), "the plugin tactile-loc-small-gicp", "pip install small-gicp"),
    Dependency("distributed", ("distributed",), "jobs on a Dask cluster", "pip install 'tactile-loc[sweep]'"),
    Dependency("mcap", ("mcap",), "recordings of ROS topics", "pip install 'tactile-loc[recordings]'"),
    Dependency("rosbags", ("rosbags",), "recordings of ROS topics", "pip install 'tactile-loc[recordings]'"),
    Dependency("pyarrow", ("pyarrow",), "benchmarks and libraries of parts", "pip install pyarrow"),
)


def examine(store: Path | None, workers: int = 4, compiling: bool = False) -> list[Diagnosis]:
    """Run all checks, `workers` at a time, and return their findings. Never raises.

    With `compiling`, the code that locates objects is also compiled.
    """
    probes = [
        Probe("versions", _check_versions, required=True),
        Probe("machine", _check_machine),
        Probe("cameras", _check_cameras),
        *(Probe(library.module, partial(_check_library, library), library.required) for library in LIBRARIES),
        Probe("system libraries", check_shared_libraries),
        Probe("plugins", _check_plugins, required=True),
        Probe("store", lambda: [_check_store(store)], required=True),
        *([Probe("kernels", lambda: [_compile_kernels()], required=True)] if compiling else []),
    ]
    with ThreadPoolExecutor(workers) as pool:
        return [check for checks in pool.map(Probe.run, probes) for check in checks]


def _check_versions() -> list[Diagnosis]:
    version = metadata.version("tactile-loc")
    python, system = platform.python_version(), f"{_name_system()}, {platform.machine()}"
    state = State.OK if sys.version_info >= PYTHON else State.BROKEN
    remedy = "" if state is State.OK else f"use Python {PYTHON[0]}.{PYTHON[1]} or newer"
    return [
        Diagnosis("tactile-loc", State.OK, version, required=True, facts={"version": version}),
        Diagnosis("python", state, f"{python} in {sys.prefix}", remedy, True, {"version": python}),
        Diagnosis("system", State.OK, system, facts={"system": system}),
    ]


def _name_system() -> str:
    try:
        return f"{platform.freedesktop_os_release()['PRETTY_NAME']} ({platform.system()} {platform.release()})"
    except (OSError, KeyError):
        return f"{platform.system()} {platform.release()}"


def _check_machine() -> list[Diagnosis]:
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    nbytes = psutil.virtual_memory().total
    says = f"{format_count(cores, 'CPU core')}, {nbytes / 1e9:.3g} GB of memory"
    return [Diagnosis("machine", State.OK, says, facts={"cores": cores, "memory_bytes": nbytes})]


def _check_cameras() -> list[Diagnosis]:
    from tactile_loc.io.streams.cameras import list_cameras

    found = list_cameras()
    return [Diagnosis("cameras", State.OK, ", ".join(found), facts={"cameras": found})] if found else []


def _check_library(library: Dependency) -> list[Diagnosis]:
    """Check that a library is installed and works."""
    version = _find_version(library.distributions)
    serves = library.serves if library.required else f"optional, for {library.serves}"
    if version is None and (failed := attempt("import", library.module)).failure:
        state = State.MISSING if "No module named" in failed.failure else State.BROKEN
        return [Diagnosis(library.module, state, serves, library.install, library.required)]
    outcome = attempt(library.trial, *([library.module] if library.trial == "import" else []))
    facts = {"version": version, **{k: v for k, v in outcome.facts.items() if k != "says"}}
    if outcome.failure:
        remedy = find_remedy(outcome.failure, library.repair or f"{library.install} --force-reinstall")
        says = f"{outcome.failure} ({serves})"
        return [Diagnosis(library.module, State.BROKEN, says, remedy, library.required, facts)]
    says = ", ".join(filter(None, [version, outcome.facts.get("says")]))
    return [Diagnosis(library.module, State.OK, says, required=library.required, facts=facts)]


def _compile_kernels() -> Diagnosis:
    """Compile and try the code that locates objects."""
    outcome = attempt("kernels", timeout_s=COMPILE_S)
    if outcome.failure:
        remedy = find_remedy(outcome.failure, "run `tactile-loc -vv run` for details")
        return Diagnosis("kernels", State.BROKEN, outcome.failure, remedy, required=True)
    facts = {"seconds": outcome.facts["seconds"]}
    return Diagnosis("kernels", State.OK, str(outcome.facts["says"]), required=True, facts=facts)


def _find_version(distributions: Sequence[str]) -> str | None:
    for name in distributions:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return None


def _check_plugins() -> Iterator[Diagnosis]:
    from tactile_loc.slots.registry import BUILT_IN, registry

    found = registry()
    distributions = list(dict.fromkeys(component.distribution for component in found.components))
    facts = {"components": len(found.components), "distributions": distributions}
    if BUILT_IN in distributions:
        says = f"{len(found.components)} components of {', '.join(distributions)}"
        yield Diagnosis("plugins", State.OK, says, required=True, facts=facts)
    else:
        remedy = "pip install --force-reinstall --no-deps tactile-loc"
        yield Diagnosis("plugins", State.BROKEN, "the built-in components are not registered", remedy, True, facts)
    for failure in found.failures:
        remedy = f"update or uninstall {failure.distribution}"
        yield Diagnosis(f"plugin {failure.plugin}", State.BROKEN, f"of {failure.distribution}: {failure.error}", remedy)


def _check_store(folder: Path | None) -> Diagnosis:
    from tactile_loc.core.runtime.formatting import format_bytes
    from tactile_loc.store.store import StageStore

    root = StageStore(folder).root
    existing = next(path for path in (root, *root.parents) if path.exists())
    remedy = "choose another folder with TACTILE_LOC_STORE or --store"
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        return Diagnosis("store", State.BROKEN, f"{root} cannot be written ({error.strerror})", remedy, True)
    nbytes, free = sum(entry.nbytes for entry in StageStore(folder).entries()), shutil.disk_usage(existing).free
    says = f"{root} holds {format_bytes(nbytes)}; {format_bytes(free)} are free on its disk"
    facts = {"folder": str(root), "bytes": nbytes, "free_bytes": free}
    if free < LITTLE_DISK_B:
        return Diagnosis(
            "store", State.OK, f"{says} ({LOW_DISK})", f"tactile-loc store prune, or {remedy}", True, facts
        )
    return Diagnosis("store", State.OK, says, required=True, facts=facts)
