"""`tactile-loc objects`: what there is to try."""

from __future__ import annotations

from typing import Any

from tactile_loc_cli.console import output


def objects() -> dict[str, Any]:
    """List the demo objects."""
    from rich.table import Table

    from tactile_loc.data import DEMO_OBJECTS

    table = Table(box=None)
    for name in ("object", "symmetry", "description"):
        table.add_column(name, overflow="fold", no_wrap=name != "description")
    for demo in DEMO_OBJECTS.values():
        table.add_row(demo.name, demo.symmetry, demo.description)
    output().print(table)
    return {
        "objects": [
            {"name": demo.name, "symmetry": demo.symmetry, "description": demo.description, "path": str(demo.path)}
            for demo in DEMO_OBJECTS.values()
        ]
    }
