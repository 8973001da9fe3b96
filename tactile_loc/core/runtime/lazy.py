"""Modules whose names are imported at their first use, and modules that are imported ahead of it."""

import ast
import gc
import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Thread
from typing import Any

HOMES: dict[str, dict[str, str]] = {}  # of each lazy module: its names, with the modules from which they are imported


def lazy_names(
    module: str, **made: Callable[[], Any]
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of a module, from the names under its `if TYPE_CHECKING:`.

    Type checkers read the same block, so each name and its module are written only once. `made` are other names, with
    functions that make their values.
    """
    loader: Any = vars(sys.modules[module])["__spec__"].loader
    homes = HOMES[module] = _imports_for_type_checkers(loader.get_source(module))

    def attribute(name: str) -> Any:
        if name in homes:
            with pause_collection():
                return getattr(importlib.import_module(homes[name]), name)
        if name in made:
            return made[name]()
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return sorted(homes), attribute, lambda: sorted(homes)


def _imports_for_type_checkers(source: str) -> dict[str, str]:
    """Map the names that are imported under `if TYPE_CHECKING:` to the modules from which they are imported."""
    blocks = (node for node in ast.parse(source).body if isinstance(node, ast.If))
    body = next(block.body for block in blocks if ast.unparse(block.test) == "TYPE_CHECKING")
    statements = (node for node in body if isinstance(node, ast.ImportFrom))
    return {alias.name: str(node.module) for node in statements for alias in node.names}


@contextmanager
def pause_collection() -> Iterator[None]:
    """Do not look for garbage until the block ends, and count all objects as old then.

    It is for imports, which make many objects that stay.
    """
    looks = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if looks and not gc.get_freeze_count():
            gc.freeze()
            gc.unfreeze()  # into the oldest generation
        if looks:
            gc.enable()


def import_ahead(*modules: str) -> Thread:
    """Start a thread that imports modules while other threads compute. Join it before the modules are used.

    An import that fails is tried again where the module is used, which raises the error.
    """

    def import_all() -> None:
        with suppress(Exception):
            for module in modules:
                importlib.import_module(module)

    thread = Thread(target=import_all, name="tactile-loc-import", daemon=True)
    thread.start()
    return thread
