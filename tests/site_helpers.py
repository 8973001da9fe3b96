"""A small documentation site with the settings of the project's own site."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import yaml

ROOT = Path(__file__).parents[1]
MODULE = '''"""A module."""

class Sensor:
    """A sensor."""

    def read(self) -> int:
        """Read a touch."""

class Camera(Sensor):
    """A camera."""

    def follow(self, first: Sensor, second: Sensor) -> Sensor:
        """Follow two others."""
'''
PAGES = {
    "index.md": "# Home\n\nSee [the part below](other.md#the-part-below) and [the API](api.md).\n",
    "other.md": "# Other\n\n## The part below\n\nText.\n",
    "api.md": "# API\n\n::: small.Sensor\n\n::: small.Camera\n",
}


class _SettingsLoader(yaml.SafeLoader):
    """A reader that does not import the functions that a file names."""


_SettingsLoader.add_multi_constructor("tag:yaml.org,2002:python/name:", lambda loader, suffix, node: suffix)


def read_settings() -> dict[str, Any]:
    """Return mkdocs.yml, with the names of functions as strings."""
    return yaml.load((ROOT / "mkdocs.yml").read_text(), _SettingsLoader)


class Site:
    """A site with the project's Makefile, mkdocs.yml and hooks, and its own pages and module."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "docs").mkdir()
        (folder / "scripts").mkdir()
        shutil.copy(ROOT / "Makefile", folder)
        for name in ("site_checks.py", "site_notebooks.py", "notebooks.py"):
            shutil.copy(ROOT / "scripts" / name, folder / "scripts")
        for name in ("javascripts", "stylesheets"):
            shutil.copytree(ROOT / "docs" / name, folder / "docs" / name)
        self._settings, _ = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")
        self._list_pages([])
        (folder / "small.py").write_text(MODULE)
        self.write(PAGES)
        self._pretend_setup()

    def _pretend_setup(self) -> None:
        """Make a .venv of this Python that is newer than its sources."""
        for name in ("pyproject.toml", "constraints.txt"):
            (self.folder / name).touch()
            os.utime(self.folder / name, (0, 0))
        python = self.folder / ".venv" / "bin" / "python"
        python.parent.mkdir(parents=True)
        python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
        python.chmod(0o755)
        (self.folder / ".venv" / ".installed").write_text(f"{self.folder}\n")

    def write_page(self, name: str, text: str) -> Path:
        """Write a page, add it to the navigation, and return where the site has it."""
        self.write({name: text})
        self._list_pages([name])
        return self.folder / "out" / "site" / name.replace(".md", ".html")

    def write(self, pages: dict[str, str]) -> None:
        for name, text in pages.items():
            (self.folder / "docs" / name).write_text(text)

    def _list_pages(self, notebooks: list[str]) -> None:
        (self.folder / "mkdocs.yml").write_text(f"{self._settings}\nnav: [{', '.join([*PAGES, *notebooks])}]\n")

    def write_notebook(self, name: str, code: str) -> None:
        """Write a notebook with a cell of code, and add it to the navigation, which has no other notebook."""
        cells = [nbformat.v4.new_markdown_cell(f"# The notebook {name}\n\nText.\n"), nbformat.v4.new_code_cell(code)]
        (self.folder / "docs" / "notebooks").mkdir(exist_ok=True)
        nbformat.write(nbformat.v4.new_notebook(cells=cells), self.folder / "docs" / "notebooks" / f"{name}.ipynb")
        self._list_pages([f"notebooks/{name}.ipynb"])

    def make_docs(self, target: str = "docs") -> subprocess.CompletedProcess[str]:
        own = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
        return subprocess.run(["make", target], cwd=self.folder, env=own, capture_output=True, text=True, check=False)
