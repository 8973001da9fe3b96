"""`make docs` fails on any warning, prints only mistakes, and shows inherited members, on a small example site."""

from __future__ import annotations

import re

import pytest
from site_helpers import Site


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
