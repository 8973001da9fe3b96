"""The site shows notebooks as pages: text, code, outputs, and a notice where the outputs are missing."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from site_helpers import ROOT, Site, read_settings

pytest.importorskip("mkdocs")
PNG = b"\x89PNG\r\n\x1a\n"
COMPUTES = "print('forty', 40 + 2)"


@pytest.fixture
def pages(monkeypatch, tmp_path):
    module = pytest.importorskip("site_notebooks")  # in scripts
    monkeypatch.setattr(module.notebooks, "EXECUTED", tmp_path / "out")
    return module


@pytest.fixture
def source(tmp_path) -> Path:
    cells = [new_markdown_cell("# Title\n\nSubject."), new_code_cell("a = '```'"), new_markdown_cell("## Part")]
    path = tmp_path / "one.ipynb"
    nbformat.write(new_notebook(cells=cells), path)
    return path


def write_outputs(pages, source: Path, *outputs: nbformat.NotebookNode) -> None:
    notebook = nbformat.read(source, as_version=4)
    notebook.cells[1].outputs = list(outputs)
    notebook.metadata[pages.notebooks.KEY] = pages.notebooks.compute_key(source)
    pages.notebooks.EXECUTED.mkdir()
    nbformat.write(notebook, pages.notebooks.EXECUTED / source.name)


def test_a_page_without_outputs_says_so_below_its_subject(pages, source):
    text, pictures = pages.convert(source, "one/")
    assert pictures == {}
    assert 'class="result"' not in text
    order = ["# Title", "Subject.", '!!! warning "Without outputs"', "````python\na = '```'\n````", "## Part"]
    assert [text.index(part) for part in order] == sorted(text.index(part) for part in order)
    assert 'href="one/one.ipynb"' in text


def test_each_output_is_shown_in_its_richest_form(pages, source):
    rich = {"text/html": "<b>certain</b>", "text/plain": "Localization(...)"}
    picture = {"image/png": base64.b64encode(PNG).decode(), "text/plain": "<Figure>"}
    write_outputs(
        pages, source,
        new_output("stream", text="\x1b[31mred\x1b[0m\n"),
        new_output("execute_result", data=rich),
        new_output("display_data", data=picture),
        new_output("execute_result", data={"text/plain": "[1]"}),
    )  # fmt: skip
    text, pictures = pages.convert(source, "one/")
    assert pictures == {"1.png": PNG}
    (shown,) = re.findall(r'<div class="result" markdown>\n\n(.*)\n\n</div>', text, re.DOTALL)
    assert shown.split("\n\n") == [
        "```text\nred\n```", "<b>certain</b>", "[![Output 1](one/1.png)](one/1.png)", "```text\n[1]\n```"
    ]  # fmt: skip
    assert "Without outputs" not in text


def test_outputs_of_an_earlier_notebook_are_not_shown(pages, source):
    write_outputs(pages, source, new_output("stream", text="old"))
    assert "old" in pages.convert(source, "one/")[0]
    changed = nbformat.read(source, as_version=4)
    changed.cells[1].source = "a = 2"
    nbformat.write(changed, source)
    text, _ = pages.convert(source, "one/")
    assert "old" not in text
    assert "Without outputs" in text


@pytest.mark.slow
def test_the_site_executes_a_notebook_once_and_shows_it(tmp_path):
    site = Site(tmp_path.resolve())
    site.write_notebook("sums", COMPUTES)
    page = site.folder / "out" / "site" / "notebooks" / "sums.html"
    quick = site.make_docs("docs-quick")
    assert (quick.returncode, quick.stdout, quick.stderr) == (0, "docs: out/site/index.html\n", "")
    assert "Without outputs" in page.read_text()
    made = site.make_docs()
    assert (made.returncode, made.stderr) == (0, "")
    text = page.read_text()
    assert "forty 42" in text
    assert "Without outputs" not in text
    assert (page.parent / "sums" / "sums.ipynb").read_bytes() == (
        site.folder / "docs/notebooks/sums.ipynb"
    ).read_bytes()
    assert "sums has not changed" in site.make_docs().stdout
    site.write_notebook("sums", "1 / 0")
    assert site.make_docs().returncode != 0


@pytest.mark.slow
def test_a_broken_link_in_a_notebook_is_reported(tmp_path):
    site = Site(tmp_path.resolve())
    site.write_notebook("sums", COMPUTES)
    path = site.folder / "docs" / "notebooks" / "sums.ipynb"
    notebook = nbformat.read(path, as_version=4)
    notebook.cells[0].source += "\n[absent](../absent.md)\n"
    nbformat.write(notebook, path)
    made = site.make_docs("docs-quick")
    assert made.returncode != 0
    assert "absent.md" in made.stderr


def list_pages(nav: str | list | dict) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    return [page for part in (nav.values() if isinstance(nav, dict) else nav) for page in list_pages(part)]


def test_the_navigation_lists_every_notebook():
    listed = [Path(page).stem for page in list_pages(read_settings()["nav"]) if page.endswith(".ipynb")]
    assert sorted(listed) == sorted(path.stem for path in (ROOT / "docs" / "notebooks").glob("*.ipynb"))
