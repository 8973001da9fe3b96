"""`tactile-loc new-plugin`: a package for a new component, complete and tested."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from tactile_loc_cli.console import say

Slot = Annotated[
    str,
    typer.Argument(
        metavar="SLOT",
        help="What it is: sensor, renderer, grid, encoder, matcher, refiner or fuser.",
        show_default=False,
    ),
]
Name = Annotated[
    str,
    typer.Argument(metavar="NAME", help="What it is called: lower case, words joined by hyphens.", show_default=False),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="FOLDER", help="The folder to make; by default tactile-loc-NAME."),
]


def new_plugin(slot: Slot, name: Name, out: Out = None) -> dict[str, Any]:
    """Write a package for a new component.

    It can be installed as it is: a small component that works, a hook by which tactile-loc finds it, and tests. Replace
    what it does by what you have in mind; docs/tutorial-plugin.md shows how.
    """
    from tactile_loc_cli.scaffold.naming import Naming
    from tactile_loc_cli.scaffold.package import write

    naming = Naming(slot, name)
    naming.require_free()
    folder = Path(naming.distribution) if out is None else out
    files = write(naming, folder)
    say(f"written: {folder}")
    for file in files:
        say(f"  {file}")
    say("\nnext:")
    for command in _next(naming.slot, naming.name, folder):
        say(f"  {command}")
    return {"slot": slot, "name": name, "folder": str(folder), "files": files}


def _next(slot: str, name: str, folder: Path) -> list[str]:
    """The three commands that come next; a folder's path, since pip takes a bare name for one to download."""
    path = folder if folder.is_absolute() else Path(".") / folder
    where = shlex.quote(str(path) if path.is_absolute() else f"./{path}")
    return [f"pip install -e {where}", f"tactile-loc plugins {slot} {name} --check", f"pytest {where}"]
