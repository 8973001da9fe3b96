"""`tactile-loc new-plugin`: write a complete, tested package for a new component."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from tactile_loc_cli.console import say
from tactile_loc_cli.options import declare

Slot = Annotated[
    str,
    typer.Argument(
        metavar="SLOT",
        help="Slot of the component: sensor, renderer, grid, encoder, matcher, refiner or fuser. For a "
        "benchmark: method or touch-source.",
        show_default=False,
    ),
]
Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Its name: lower case, words joined by hyphens.", show_default=False)
]
Out = Annotated[Path | None, declare("--out FOLDER", "New folder to write. Default: tactile-loc-NAME.")]


def new_plugin(slot: Slot, name: Name, out: Out = None) -> dict[str, Any]:
    """Write a package for a new component.

    The package has a small working component, its registration as a plugin, and tests. It can be installed at once.
    Replace the component's code with yours; docs/tutorial-plugin.md shows how.
    """
    from tactile_loc_cli.scaffold.package import Naming, write

    naming = Naming(slot, name)
    naming.require_free()
    folder = Path(naming.distribution) if out is None else out
    files = write(naming, folder)
    say(f"written: {folder}")
    for file in files:
        say(f"  {file}")
    say()
    say("next:")
    where = shlex.quote(str(folder) if folder.is_absolute() else f"./{folder}")  # pip would download a bare name
    for command in (f"pip install -e {where}", f"tactile-loc plugins {slot} {name} --check", f"pytest {where}"):
        say(f"  {command}")
    return {"slot": slot, "name": name, "folder": str(folder), "files": files}
