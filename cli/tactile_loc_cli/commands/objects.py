"""`tactile-loc objects`: what there is to try."""

from __future__ import annotations

from tactile_loc_cli.console import output


def objects() -> None:
    """List the demo objects."""
    from rich.table import Table

    from tactile_loc.data import DEMO_OBJECTS

    table = Table(box=None)
    for name in ("object", "symmetry", "description"):
        table.add_column(name, overflow="fold", no_wrap=name != "description")
    for demo in DEMO_OBJECTS.values():
        table.add_row(demo.name, demo.symmetry, demo.description)
    output().print(table)
