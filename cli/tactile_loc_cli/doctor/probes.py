"""Everything that is looked at, in the order in which it is shown."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path

from tactile_loc_cli.doctor.check import Check, Probe, State
from tactile_loc_cli.doctor.outside import attempt
from tactile_loc_cli.doctor.system import install, remedy_for, shared_libraries

PYTHON = (3, 11)
LITTLE_DISK_B = 2e9
LOW_DISK = "little: models of large grids take gigabytes"


@dataclass(frozen=True)
class Library:
    """A library, by its module; `distributions` are the names that pip may know it by, `serves` what needs it."""

    module: str
    distributions: tuple[str, ...]
    serves: str
    install: str
    required: bool = False
    trial: str = "import"
    repair: str = ""  # what to do when it is installed and does not work; by default install it anew


def _needed(module: str, *distributions: str, trial: str = "import", serves: str = "") -> Library:
    names = distributions or (module,)
    return Library(module, names, serves or "needed by everything", f"pip install {names[0]}", True, trial)


LIBRARIES = (
    _needed("numpy"),
    _needed("scipy"),
    _needed("numba", trial="numba"),
    _needed("trimesh"),
    _needed("networkx"),
    _needed("rtree"),
    _needed("faiss", "faiss-cpu", "faiss-gpu", serves="the matcher faiss"),
    _needed("matplotlib"),
    _needed("PIL", "pillow"),
    _needed("jinja2", serves="reports"),
    _needed("plotly", serves="reports"),
    _needed("open3d", "open3d-cpu", "open3d", trial="open3d", serves="the renderer raycast, the refiner icp, pictures"),
    Library("pyrender", ("pyrender",), "the renderer pyrender", "pip install pyrender", trial="egl",
            repair=install("libegl1 libgl1-mesa-dri")),
    Library("torch", ("torch",), "the encoder moco, and sensors that read images", "pip install 'tactile-loc[learned]'",
            trial="torch"),
    Library("safetensors", ("safetensors",), "what is learned", "pip install 'tactile-loc[learned]'"),
    Library("kiss_icp", ("kiss-icp",), "the refiner kiss-icp", "pip install 'tactile-loc[kiss]'"),
    Library("small_gicp", ("small-gicp",), "the plugin tactile-loc-small-gicp", "pip install small-gicp"),
    Library("distributed", ("distributed",), "sweeps over several machines", "pip install 'tactile-loc[sweep]'"),
    Library("pyarrow", ("pyarrow",), "sweep tables as Parquet", "pip install 'tactile-loc[sweep]'"),
)  # fmt: skip


def examine(store: Path | None, workers: int = 4) -> list[Check]:
    """Look at everything, several things at a time, and return what was found. Never raises."""
    probes = [
        Probe("versions", _versions, required=True),
        Probe("machine", _machine),
        *(Probe(library.module, partial(_library, library), library.required) for library in LIBRARIES),
        Probe("system libraries", lambda: list(shared_libraries())),
        Probe("plugins", lambda: list(_plugins()), required=True),
        Probe("store", lambda: [_store(store)], required=True),
    ]
    with ThreadPoolExecutor(workers) as pool:
        return [check for checks in pool.map(Probe.checks, probes) for check in checks]


def _versions() -> Sequence[Check]:
    version = metadata.version("tactile-loc")
    python, system = platform.python_version(), f"{_system()}, {platform.machine()}"
    state = State.OK if sys.version_info >= PYTHON else State.BROKEN
    remedy = "" if state is State.OK else f"make an environment with Python {PYTHON[0]}.{PYTHON[1]} or newer"
    return [
        Check("tactile-loc", State.OK, version, required=True, facts={"version": version}),
        Check("python", state, f"{python} in {sys.prefix}", remedy, True, {"version": python}),
        Check("system", State.OK, system, facts={"system": system}),
    ]


def _system() -> str:
    try:
        return f"{platform.freedesktop_os_release()['PRETTY_NAME']} ({platform.system()} {platform.release()})"
    except (OSError, KeyError):
        return f"{platform.system()} {platform.release()}"


def _machine() -> Sequence[Check]:
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    nbytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    says = f"{cores} CPU {'core' if cores == 1 else 'cores'}, {nbytes / 1e9:.3g} GB of memory"
    return [Check("machine", State.OK, says, facts={"cores": cores, "memory_bytes": nbytes})]


def _library(library: Library) -> Sequence[Check]:
    """Whether a library is installed and works."""
    version = _version_of(library.distributions)
    serves = library.serves if library.required else f"optional, for {library.serves}"
    if version is None and (failed := attempt("import", library.module)).failure:
        state = State.MISSING if "No module named" in failed.failure else State.BROKEN
        return [Check(library.module, state, serves, library.install, library.required)]
    outcome = attempt(library.trial, *([library.module] if library.trial == "import" else []))
    facts = {"version": version, **{k: v for k, v in outcome.facts.items() if k != "says"}}
    if outcome.failure:
        remedy = remedy_for(outcome.failure, library.repair or f"{library.install} --force-reinstall")
        says = f"{outcome.failure} ({serves})"
        return [Check(library.module, State.BROKEN, says, remedy, library.required, facts)]
    says = ", ".join(filter(None, [version, outcome.facts.get("says")]))
    return [Check(library.module, State.OK, says, required=library.required, facts=facts)]


def _version_of(distributions: Sequence[str]) -> str | None:
    for name in distributions:
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return None


def _plugins() -> Iterator[Check]:
    from tactile_loc.core.registry import BUILT_IN, registry

    found = registry()
    distributions = list(dict.fromkeys(component.distribution for component in found.components))
    facts = {"components": len(found.components), "distributions": distributions}
    if BUILT_IN in distributions:
        says = f"{len(found.components)} components of {', '.join(distributions)}"
        yield Check("plugins", State.OK, says, required=True, facts=facts)
    else:
        remedy = "install tactile-loc anew: pip install --force-reinstall --no-deps tactile-loc"
        yield Check("plugins", State.BROKEN, "the built-in components are not registered", remedy, True, facts)
    for failure in found.failures:
        remedy = f"update or uninstall {failure.distribution}"
        yield Check(f"plugin {failure.plugin}", State.BROKEN, f"of {failure.distribution}: {failure.error}", remedy)


def _store(folder: Path | None) -> Check:
    from tactile_loc.store.store import StageStore
    from tactile_loc_cli.stored import size_in_words

    root = StageStore(folder).root
    existing = next(path for path in (root, *root.parents) if path.exists())
    remedy = "choose another folder with TACTILE_LOC_STORE or --store"
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        return Check("store", State.BROKEN, f"{root} cannot be written to ({error.strerror})", remedy, True)
    nbytes, free = sum(entry.nbytes for entry in StageStore(folder).entries()), shutil.disk_usage(existing).free
    says = f"{root} holds {size_in_words(nbytes)}, {size_in_words(free)} are free on its disk"
    facts = {"folder": str(root), "bytes": nbytes, "free_bytes": free}
    if free < LITTLE_DISK_B:
        return Check("store", State.OK, f"{says} ({LOW_DISK})", f"tactile-loc store prune, or {remedy}", True, facts)
    return Check("store", State.OK, says, required=True, facts=facts)
