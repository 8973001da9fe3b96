"""Hashes of code. The hash of a component's code is part of all keys of the store that contain the component."""

import hashlib
import inspect
import re
import site
import sys
import sysconfig
import uuid
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module, metadata
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any, NamedTuple

from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.core.runtime.lazy import HOMES

PACKAGE = "tactile_loc"
# The packages that compute results. The other packages read files, check options or report progress.
KERNELS = tuple(f"{PACKAGE}.{name}." for name in ("bases", "core", "plugins", "sensors", "simulate"))
NO_KERNELS = f"{PACKAGE}.core.runtime."
SUFFIXES = (".py", *EXTENSION_SUFFIXES)

# These patterns find imports ten times faster than `ast.parse`. A text that looks like an import does no harm.
_IMPORT = re.compile(r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import\b[ \t]*(\([^)]*\)|.*)|import[ \t]+(.*))", re.MULTILINE)
_NO_IMPORT = re.compile(r"#.*|\\\n")
_NAME = re.compile(r"[\w.]+|\*")

Files = dict[str, Path]  # by the path from the folder of the top-level package or module


def find_plugins() -> list[metadata.EntryPoint]:
    """Return the entry points of plugins: those of the group `tactile_loc`, and of the groups `tactile_loc.SLOT`."""
    found = metadata.entry_points()  # read once for all groups, because this reads many files
    groups = sorted(group for group in found.groups if f"{group}.".startswith(f"{PACKAGE}."))
    return [plugin for group in groups for plugin in found.select(group=group)]


@cache
def hash_code(name: str) -> str:
    """Return the SHA-256 (hex) of the file of a module, or of all files in the folder of a package.

    A process keeps its first hash of a module, because it also keeps the imported code. Raises StoreError if the code
    is not in files.
    """
    files = _list_files(name)
    if not files:
        raise StoreError(f"the code of {name} is not in files, so its changes are not seen; install it in a folder")
    return _hash_files(files)


@cache
def hash_component(kind: type[Any]) -> str:
    """Return the SHA-256 (hex) of the code that computes the results of a component class.

    The code is all files in the folder of its package, or its module if that is in no package. It includes what these
    import from their distribution, from modules beside them, and from the numerical packages of tactile-loc. Of a
    component of tactile-loc, only the module itself and its imports count. The modules of base classes count, too.

    The hash does not depend on the folder of the installation or on line endings. A process keeps the first hash. Code
    that is not in files has another hash in each process.
    """
    files: Files = {}
    for base in kind.__mro__:
        if hasattr(base, "slot"):
            files |= _follow_imports(base.__module__, whole=base is kind)
    source = "" if _list_files(kind.__module__, whole=False) else _read_source(kind)
    return hashlib.sha256(f"{_hash_files(files)} {source}".encode()).hexdigest()


def _follow_imports(module: str, whole: bool) -> Files:
    """Return the file of a module, or all files in its package's folder if `whole`, and the files that they import."""
    built_in = module.startswith(f"{PACKAGE}.")
    own: set[str] = set() if built_in else _list_installed_together(module.partition(".")[0])
    package = module.rpartition(".")[0]
    waiting = _list_files(package if whole and package and not built_in else module, whole)
    found: Files = {}
    seen: set[str] = set()
    while waiting:
        place, path = waiting.popitem()
        found[place] = path
        for name in set(_scan_file(place, path).imports) - seen:
            seen.add(name)
            if name.startswith(KERNELS):
                files = {} if name.startswith(NO_KERNELS) else _list_kernel(name)
            elif not built_in and (name.partition(".")[0] in own or _is_beside(name, module)):
                files = _list_files(name, whole=False)
            else:
                continue
            waiting |= {place: file for place, file in files.items() if place not in found}
    return found


@cache
def _list_kernel(name: str) -> Files:
    return _list_files(name, whole=False)


class Scan(NamedTuple):
    """The SHA-256 of a file, and the names of modules that it may import."""

    digest: str
    imports: tuple[str, ...]


def _scan_file(place: str, path: Path) -> Scan:
    """Scan a file, or remember it by its time and size. Raises StoreError if it cannot be read."""
    try:
        state = path.stat()
        return _scan(place, path, (state.st_mtime_ns, state.st_size))
    except OSError as error:
        raise StoreError(f"{path} cannot be read ({error.strerror}); check its permissions") from error


@cache
def _scan(place: str, path: Path, state: tuple[int, int]) -> Scan:
    """Scan a file with `\\n` as the end of each line of a text. `state` identifies the content."""
    content = path.read_bytes()
    if b"\0" not in content:
        content = content.replace(b"\r\n", b"\n")
    imports = _find_imports(content.decode("utf-8", "replace"), place) if path.suffix == ".py" else ()
    return Scan(hashlib.sha256(content).hexdigest(), tuple(imports))


def _find_imports(source: str, place: str) -> Iterator[str]:
    """Yield the names of modules that a source may import; for a name of `tactile_loc.plugin`, also its home."""
    package = ".".join(Path(place).parts[:-1])
    for start, names, modules in _IMPORT.findall(_NO_IMPORT.sub("", source).replace(";", "\n")):
        if modules:
            listed = [name.split()[0] for name in modules.split(",") if name.strip()]
            yield from (home for name in listed for home in (name, *_find_homes(name).values()))
            continue
        with suppress(ImportError):  # more dots than packages
            start = resolve_name(start, package)
        listed, homes = _NAME.findall(names), _find_homes(start)
        yield from (start, *(f"{start}.{name}" for name in listed))
        yield from (homes.values() if "*" in listed else (homes[name] for name in listed if name in homes))


def _find_homes(module: str) -> dict[str, str]:
    if module in (f"{PACKAGE}.plugin", f"{PACKAGE}.plugin.helpers"):
        import_module(module)
    return HOMES.get(module, {})


def _list_files(name: str, whole: bool = True) -> Files:
    """Return the file of a module, or the files in the folder of a package: all, or only its own if not `whole`."""
    top, *inner = name.split(".")
    found: Files = {}
    for start in _find_top(top):
        path = start.joinpath(*inner)
        files = [path] if start.is_file() else [path.with_name(path.name + suffix) for suffix in SUFFIXES]
        if path.is_dir():
            files = [*path.rglob("*")] if whole else [path / "__init__.py"]
        kept = (file for file in files if file.parent.name != "__pycache__" and file.is_file())
        found |= {file.relative_to(start.parent).as_posix(): file for file in kept}
    return found


def _find_top(name: str) -> tuple[Path, ...]:
    """Return the folders of a top-level package, or the file of a top-level module; nothing if there are none."""
    found: Any = sys.modules.get(name)
    folders, file = getattr(found, "__path__", ()), getattr(found, "__file__", None)
    if found is None:
        with suppress(ImportError, ValueError):
            found = find_spec(name)
            folders, file = getattr(found, "submodule_search_locations", ()), getattr(found, "origin", None)
    return tuple(path for path in map(Path, folders or ([file] if file else [])) if path.exists())


def _is_beside(name: str, module: str) -> bool:
    """Return whether a module lies in the same folder as another, outside of the folders for installed packages."""
    beside = {path.parent for path in _find_top(name.partition(".")[0])}
    return bool(beside & {path.parent for path in _find_top(module.partition(".")[0])} - _list_shared_folders())


@cache
def _list_shared_folders() -> set[Path]:
    paths = (sysconfig.get_path(name) for name in ("purelib", "platlib", "stdlib", "platstdlib"))
    return {*map(Path, paths), Path(site.getusersitepackages())}


def _list_installed_together(top: str) -> set[str]:
    """Return the names of the top-level packages and modules of the plugin's distribution that has `top`."""
    found = {top}
    for plugin in find_plugins():
        files = (plugin.dist.files if plugin.dist else None) or []
        names = {Path(file.parts[0]).stem for file in files if file.suffix == ".py"}
        found |= names if top in names else set()
    return found


def _hash_files(files: Files) -> str:
    digest = hashlib.sha256()
    for place, path in sorted(files.items()):
        digest.update(f"{place} {_scan_file(place, path).digest}\n".encode())
    return digest.hexdigest()


def _read_source(kind: type[Any]) -> str:
    """Return the source of a class that is in no file, as in a notebook, or a random text if Python has no source."""
    with suppress(OSError, TypeError):
        return inspect.getsource(kind)
    return uuid.uuid4().hex
