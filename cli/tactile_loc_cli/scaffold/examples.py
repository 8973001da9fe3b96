"""Writes docs/plugin-examples.md from the templates of new packages: `python -m tactile_loc_cli.scaffold.examples`."""

from __future__ import annotations

from pathlib import Path

from tactile_loc.slots.registry import registry
from tactile_loc_cli.scaffold.package import Naming, describe_example, render

INTRODUCTION = """\
# An example of each slot

This page is generated: `python -m tactile_loc_cli.scaffold.examples` writes it, and a test compares it with the
program.

`tactile-loc new-plugin SLOT NAME` writes a package for a component of any slot, for a source or method of a
[benchmark](benchmark.md), or for a command. This page shows the example module of each slot. All examples pass the
[contract checks](plugins.md#contract-checks). Replace the computation, and keep the structure. [Plugins](plugins.md)
explains the hook and the packaging, which are the same for every slot.

| slot | what the example does |
|---|---|
"""


def make_examples() -> str:
    """Return the text of docs/plugin-examples.md."""
    kinds = registry().kinds
    rows = "".join(f"| [{kind}](#{kind}) | {describe_example(kind)} |\n" for kind in kinds)
    return INTRODUCTION + rows + "".join(map(_show, kinds))


def _show(slot: str) -> str:
    """Return the section of a slot: the command, and the module that the command writes."""
    naming = Naming(slot, f"my-{slot}")
    path = f"{naming.package}/{naming.module}.py"
    command = f"    tactile-loc new-plugin {slot} {naming.name}"
    return f"\n## {slot.capitalize()}\n\n{command}\n\n`{path}`\n\n```python\n{render(naming)[path]}```\n"


def main() -> None:
    """Write docs/plugin-examples.md of this module's source tree."""
    page = Path(__file__).parents[3] / "docs" / "plugin-examples.md"
    page.write_text(make_examples(), encoding="utf-8")


if __name__ == "__main__":
    main()
