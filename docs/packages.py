#!/usr/bin/env python3
"""The packages of the code, and the imports of each package, read from every import statement (also in functions).

Run this script to renew the table of docs/architecture.md and its picture, docs/images/packages.svg.
"""

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE, PICTURE = ROOT / "docs" / "architecture.md", ROOT / "docs" / "images" / "packages.svg"
FOLDERS = ("tactile_loc", "cli/tactile_loc_cli", "benchmarks", "docs")
# The lowest layer comes first. A package imports only packages of lower layers, never of its own layer.
# A number is the horizontal position of a box.
LAYERS: tuple[dict[str, float], ...] = (
    {"core": 1.8},
    {"slots": 1, "data": 3.4},
    {"bases": 1, "simulate": 2.4},
    {"plugin": 0, "store": 2.2},
    {"io": 2.8},
    {"sensors": 2},
    {"plugins": 0, "locate": 3.6},
    {"tracking": 2.8},
    {"planning": 2.8},
    {"view": 2},
    {"evaluation": 2.8, "testing": 4.6},
    {"reports": 3.2},
    {"tactile_loc": 0.4},
    {"benchmarks": 0, "cli": 2, "docs": 4},
    {"commands": 2},
)
LAYER_OF = {package: number for number, layer in enumerate(LAYERS) for package in layer}
PATHS = {
    "commands": "tactile_loc/commands.py", "tactile_loc": "tactile_loc/__init__.py",
    "cli": "cli/tactile_loc_cli", "benchmarks": "benchmarks", "docs": "docs",
}  # fmt: skip
ROW = re.compile(r"^\| `(?P<path>[\w/.]+)` \| (?P<holds>[^|]*) \|[^|]*\|[^|]*\|$", re.MULTILINE)


@dataclass(frozen=True, order=True)
class Import:
    """An import statement: the module that has it, its line, and the imported module of ours or library."""

    importer: str
    line: int
    imported: str

    def __str__(self) -> str:
        return f"{modules()[self.importer].relative_to(ROOT)}:{self.line} imports {self.imported}"


@cache
def modules() -> dict[str, Path]:
    """Return the file of every module of ours, by its name."""
    found = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            start = ROOT / folder if folder in ("benchmarks", "docs") else (ROOT / folder).parent
            parts = path.relative_to(start).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports() -> tuple[Import, ...]:
    """Return all imports in our modules, except imports of the standard library."""
    found = {found for name, path in modules().items() for found in _imports_of(name, path)}
    return tuple(sorted(i for i in found if i.imported.partition(".")[0] not in sys.stdlib_module_names))


def _imports_of(importer: str, path: Path) -> Iterator[Import]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (Import(importer, node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            named = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (Import(importer, node.lineno, n if n in modules() else str(node.module)) for n in named)


def is_ours(module: str) -> bool:
    """Return whether a module belongs to this repository."""
    return module in modules()


def package(module: str) -> str:
    """Return the package of one of our modules."""
    path = modules()[module].relative_to(ROOT).as_posix()
    alone = next((name for name, start in PATHS.items() if path == start or path.startswith(f"{start}/")), None)
    return alone or module.split(".")[1]


def packages_imported() -> dict[str, list[str]]:
    """Return the packages that each package imports, the highest layer first."""
    pairs = {(package(i.importer), package(i.imported)) for i in imports() if is_ours(i.imported)}
    return {r: sorted((b for a, b in pairs if a == r != b), key=lambda b: (-LAYER_OF[b], b)) for r in LAYER_OF}


def libraries_imported() -> dict[str, list[str]]:
    """Return the libraries that each package imports, without the standard library."""
    pairs = {(package(i.importer), i.imported.partition(".")[0]) for i in imports() if not is_ours(i.imported)}
    return {r: sorted({b for a, b in pairs if a == r}, key=str.lower) for r in LAYER_OF}


def with_table(page: str) -> str:
    """Return the page with the imports of each row's package. Raises KeyError if a row names an unknown package."""
    packages, libraries = packages_imported(), libraries_imported()

    def row(match: re.Match[str]) -> str:
        name = package_at(match["path"])
        cells = (
            f"`{match['path']}`",
            match["holds"],
            *(", ".join(r[name]) or "nothing" for r in (packages, libraries)),
        )
        return f"| {' | '.join(cells)} |"

    return ROW.sub(row, page)


def package_at(path: str) -> str:
    """Return the package at a path of the table."""
    return {start: name for name, start in PATHS.items()}.get(path, path.rpartition("/")[2])


def arrows() -> list[tuple[str, str]]:
    """Return pairs (package, imported package), without a to c if there are also a to b and b to c."""
    direct = {name: set(found) for name, found in packages_imported().items()}

    def below(name: str) -> set[str]:
        return direct[name].union(*(below(b) for b in direct[name] if LAYER_OF[b] < LAYER_OF[name]))

    return [(a, b) for a in direct for b in sorted(direct[a]) if not any(b in below(c) for c in direct[a] - {b})]


PITCH, BOX, HEIGHT, GAP = 140, 112, 36, 44  # pixels: from box to box, width and height of a box, between layers
LABELS = {"commands": "commands.py", "tactile_loc": "public API"}
STYLE = (
    "text{font:14px sans-serif;text-anchor:middle;dominant-baseline:central;fill:#1f2933}"
    "rect{fill:#eef3f8;stroke:#52606d}path{fill:none;stroke:#7b8794;stroke-width:1.3;marker-end:url(#tip)}"
)
TIP = (
    '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
    '<polygon points="0,0 8,4 0,8" fill="#7b8794"/></marker>'
)


def picture() -> str:
    """Return the picture as SVG, with a box for each package, the highest layer at the top, and all arrows."""
    width = PITCH * (1 + max(x for layer in LAYERS for x in layer.values()))
    height = len(LAYERS) * (HEIGHT + GAP)
    size = f'viewBox="0 0 {width:.0f} {height}" width="{width:.0f}" height="{height}"'
    head = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>', f"<style>{STYLE}</style><defs>{TIP}</defs>",
        f'<rect width="{width:.0f}" height="{height}" style="fill:#fff;stroke:none"/>',
    ]  # fmt: skip
    return "\n".join([*head, *(_arrow(_place(a), _place(b)) for a, b in arrows()), *map(_box, LAYER_OF), "</svg>\n"])


def _place(name: str) -> tuple[float, float]:
    """Return the middle of a package's box, in pixels."""
    above = len(LAYERS) - 1 - LAYER_OF[name]
    return PITCH * (LAYERS[LAYER_OF[name]][name] + 0.5), 0.5 * (GAP + HEIGHT) + above * (HEIGHT + GAP)


def _box(name: str) -> str:
    x, y = _place(name)
    rectangle = f'<rect x="{x - BOX / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{BOX}" height="{HEIGHT}" rx="6"/>'
    return f'{rectangle}<text x="{x:.0f}" y="{y:.0f}">{LABELS.get(name, name)}</text>'


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    """Return an arrow. It goes straight down, and bends towards its end only in the last gap between layers."""
    (x0, y0), (x1, y1) = start, end
    y0, y1 = y0 + HEIGHT / 2, y1 - HEIGHT / 2
    turn, middle = y1 - GAP, y1 - 0.4 * GAP
    return f'<path d="M{x0:.0f} {y0:.0f}V{turn:.0f}C{x0:.0f} {middle:.0f} {x1:.0f} {middle:.0f} {x1:.0f} {y1:.0f}"/>'


def main() -> None:
    """Renew the table and the picture."""
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    PICTURE.write_text(picture(), encoding="utf-8")


if __name__ == "__main__":
    main()
