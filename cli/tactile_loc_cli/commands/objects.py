"""`tactile-loc objects`: what there is to try."""

from __future__ import annotations

from typing import Any

from tactile_loc_cli.console import say_table


def objects() -> dict[str, Any]:
    """List the demo objects."""
    from tactile_loc.data import DEMO_OBJECTS

    rows = [(demo.name, demo.symmetry, demo.description) for demo in DEMO_OBJECTS.values()]
    say_table([("object", "symmetry", "description"), *rows], left=3, gap=2, fold=True)
    return {
        "objects": [
            {"name": demo.name, "symmetry": demo.symmetry, "description": demo.description, "path": str(demo.path)}
            for demo in DEMO_OBJECTS.values()
        ]
    }
