"""Links between the README, the documentation and the packages' READMEs lead to existing files and headings."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from markdown.extensions.toc import slugify, unique

ROOT = Path(__file__).parents[1]
FOLDERS = ("docs", "notes", "benchmarks", "examples", "plugins_contrib")
PAGES = sorted([*ROOT.glob("*.md"), *(page for folder in FOLDERS for page in (ROOT / folder).rglob("*.md"))])
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
HEADING = re.compile(r"^#+ (.+?)\s*$", re.MULTILINE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
PROGRAM = re.compile(r"(?<![\w/-])(?:benchmarks|docs|examples|scripts)/\w+\.(?:py|sh)\b")
MARKUP = re.compile(r"`([^`]*)`|\*+([^*]+)\*+|\[([^\]]*)\]\([^)]*\)")


def without_code(page: Path) -> str:
    return FENCED.sub("", page.read_text())


def headings(page: Path) -> list[str]:
    """The headings of a page without their markup."""
    return [MARKUP.sub(lambda m: next(filter(None, m.groups()), ""), h) for h in HEADING.findall(without_code(page))]


@cache
def anchors(page: Path) -> frozenset[str]:
    """The heading anchors that are equal on the site and on a code host.

    The two differ where a sign has spaces on both sides: "a / b" is `a-b` on the site and `a--b` on the host.
    """
    taken: set[str] = set()
    site = {unique(slugify(heading, "-"), taken) for heading in headings(page)}
    host = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings(page)}
    return frozenset(site & host)


def links(page: Path) -> list[str]:
    return [target for target in LINK.findall(without_code(page)) if not re.match(r"[a-z]+:", target)]


def test_anchors_are_equal_on_the_site_and_on_a_code_host(tmp_path):
    (page := tmp_path / "page.md").write_text(
        "# One `two`\n\n```sh\n# no heading\n```\n\n## Three, *four*\n\n## A / b\n"
    )
    assert headings(page) == ["One two", "Three, four", "A / b"]
    assert anchors(page) == {"one-two", "three-four"}


def find_broken(page: Path) -> Iterator[str]:
    """Yield a sentence for each link to a missing file or heading."""
    for target in links(page):
        path, _, anchor = re.sub(r"#only-(light|dark)$", "", target).partition("#")  # the site's palettes
        file = (page.parent / path).resolve() if path else page
        if not file.exists():
            yield f"{page} links to {target}: there is no such file"
        elif anchor and "." not in anchor and anchor not in anchors(file):
            yield f"{page} links to {target}: there is no such heading"  # the site build checks anchors with dots


def test_broken_links_are_found(tmp_path):
    (page := tmp_path / "page.md").write_text("# One\n\n[a](#one) [b](#two) [c](none.md#one) [d](page.md#three)\n")
    assert [sentence.rpartition(" links to ")[2] for sentence in find_broken(page)] == [
        "#two: there is no such heading",
        "none.md#one: there is no such file",
        "page.md#three: there is no such heading",
    ]


def test_links_lead_to_existing_files_and_headings():
    assert [sentence for page in PAGES for sentence in find_broken(page)] == []
    assert sum("#" in target for page in PAGES for target in links(page)) > 20


def test_programs_that_the_pages_name_exist():
    named = {(page, path) for page in PAGES for path in PROGRAM.findall(page.read_text())}
    assert len(named) > 20
    assert sorted(f"{page} names {path}" for page, path in named if not (ROOT / path).exists()) == []
