"""`make docs` fails on any warning, prints only mistakes, and shows inherited members, on a small example site."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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


class Site:
    """A site with the project's Makefile, mkdocs.yml and hooks, and its own pages and module."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "docs").mkdir()
        (folder / "scripts").mkdir()
        shutil.copy(ROOT / "Makefile", folder)
        shutil.copy(ROOT / "scripts" / "site_checks.py", folder / "scripts")
        settings, _ = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")
        (folder / "mkdocs.yml").write_text(f"{settings}\nnav: [{', '.join(PAGES)}]\n")
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

    def write(self, pages: dict[str, str]) -> None:
        for name, text in pages.items():
            (self.folder / "docs" / name).write_text(text)

    def make_docs(self) -> subprocess.CompletedProcess[str]:
        own = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
        return subprocess.run(["make", "docs"], cwd=self.folder, env=own, capture_output=True, text=True, check=False)


@pytest.fixture
def site(tmp_path) -> Site:
    return Site(tmp_path.resolve())


@pytest.mark.slow
def test_a_good_site_is_built_without_warnings(site):
    site.write({"drawing.py": "raise SystemExit\n"})
    made = site.make_docs()
    assert (made.returncode, made.stdout, made.stderr) == (0, "docs: out/site/index.html\n", "")
    built = site.folder / "out" / "site"
    assert {page.name for page in built.glob("*.html")} == {"404.html", "index.html", "other.html", "api.html"}
    assert not list(built.rglob("drawing*")), "code beside the pages is not part of the site"
    names = set(re.findall(r'id="(small[^"]*)"', (built / "api.html").read_text()))
    assert names == {"small.Sensor", "small.Sensor.read", "small.Camera", "small.Camera.read", "small.Camera.follow"}


def test_every_kind_of_mistake_is_reported_and_fails(site):
    site.write(
        {
            "index.md": "# Home\n\n[a](other.md#the-part-above), [b](absent.md), [c](/other.md), ![d](absent.png)\n",
            "other.md": "# Other\n\n## The part below\n\n::: small.Sensor\n",
            "stray.md": "# Stray\n",
        }
    )
    made = site.make_docs()
    assert made.returncode != 0
    told = [line for line in made.stderr.splitlines() if not line.startswith("make")]
    for mistake in (
        "'other.md#the-part-above', but the doc 'other.md' does not contain an anchor '#the-part-above'",
        "'absent.md', but the target is not found",
        "absolute link '/other.md'",
        "'absent.png', but the target",
        "Multiple primary URLs found for 'small.Sensor'",
        "'other.md' documents 'small.Sensor', which 'api.md' documents already",
        'are not included in the "nav"',
        "- stray.md",
    ):
        assert any(mistake in line for line in told), (mistake, made.stderr)
    assert not any(line.startswith("INFO") or "small.Sensor.read" in line for line in told)
    assert len(set(told)) == len(told), "each mistake is reported once"
