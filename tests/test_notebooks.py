"""The notebooks run, explain themselves and are in git without outputs. The site shows them with their outputs."""

import base64
import re
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from page_helpers import DOCS, ROOT, read_page

NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
NAMES = [path.stem for path in NOTEBOOKS]
LONGEST_CELL = 25  # lines
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def notebooks():
    return pytest.importorskip("notebooks")  # in scripts


@pytest.fixture(params=NOTEBOOKS, ids=NAMES)
def source(request) -> nbformat.NotebookNode:
    return nbformat.read(request.param, as_version=4)


def code_of(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_the_page_lists_all_notebooks():
    assert len(NAMES) == 5
    assert sorted(re.findall(r"\]\(notebooks/([\w-]+)\.ipynb\)", read_page("examples.md"))) == NAMES


def test_a_notebook_explains_itself_and_has_no_outputs(source):
    nbformat.validate(source)
    assert all(not cell.outputs and cell.execution_count is None for cell in code_of(source))
    assert source.metadata.kernelspec.name == "python3"
    first, second = source.cells[:2]
    assert first.cell_type == "markdown"
    assert re.match(r"# .+\n\n.+", first.source)
    assert 'find_spec("tactile_loc") is None' in second.source
    assert "%pip install" in second.source
    assert all(len(cell.source.splitlines()) <= LONGEST_CELL for cell in source.cells)
    assert not re.search(r"/(home|tmp|work|root|Users)/", "".join(cell.source for cell in source.cells))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_and_shows_its_results(notebooks, name, monkeypatch, store):
    """The executed notebook stays in out/notebooks, where `make docs` finds it."""
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    monkeypatch.setenv("PYTHONPATH", ":".join([str(ROOT), str(ROOT / "cli")]))
    path = DOCS / "notebooks" / f"{name}.ipynb"
    executed = notebooks.read_executed(path) or nbformat.read(notebooks.write_executed(path), as_version=4)
    outputs = [output for cell in code_of(executed) for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert any("text/html" in output.get("data", {}) for output in outputs)
    assert not any("warning" in output.get("text", "").lower() for output in outputs if output.get("name") == "stderr")


@pytest.fixture
def elsewhere(notebooks, monkeypatch, tmp_path) -> Path:
    """A project without notebooks: its folder of notebooks. The program runs there, without arguments."""
    (tmp_path / "in").mkdir()
    for name, value in (("SOURCES", tmp_path / "in"), ("EXECUTED", tmp_path / "out"), ("ROOT", tmp_path)):
        monkeypatch.setattr(notebooks, name, value)
    monkeypatch.setattr(sys, "argv", ["notebooks.py"])
    return tmp_path / "in"


def write_notebook(path: Path, *cells: nbformat.NotebookNode) -> Path:
    nbformat.write(new_notebook(cells=list(cells)), path)
    return path


def test_only_changed_notebooks_are_executed(notebooks, elsewhere, monkeypatch):
    executed: list[str] = []

    def execute(path: Path) -> nbformat.NotebookNode:
        executed.append(path.stem)
        return nbformat.read(path, as_version=4)

    def run(*words: str) -> list[str]:
        executed.clear()
        monkeypatch.setattr(sys, "argv", ["notebooks.py", *words])
        assert notebooks.main() == 0
        return list(executed)

    monkeypatch.setattr(notebooks, "execute", execute)
    first, _ = (write_notebook(elsewhere / f"{name}.ipynb", new_code_cell("1")) for name in ("first", "second"))
    assert run() == ["first", "second"]
    assert run() == []
    write_notebook(first, new_code_cell("2"))
    assert notebooks.read_executed(first) is None
    assert run() == ["first"]
    assert run("--again", "second") == ["second"]
    module = elsewhere.parent / "tactile_loc" / "module.py"
    module.parent.mkdir()
    module.write_text("a = 1")
    notebooks._hash_package.cache_clear()
    assert run() == ["first", "second"], "the package has changed"


@pytest.fixture
def pages(monkeypatch, tmp_path):
    pytest.importorskip("mkdocs")
    module = pytest.importorskip("site_notebooks")  # in scripts
    monkeypatch.setattr(module.notebooks, "EXECUTED", tmp_path / "out")
    return module


def test_each_output_is_shown_in_its_richest_form_while_it_is_current(pages, tmp_path):
    cells = [new_markdown_cell("# Title\n\nSubject."), new_code_cell("a = '```'"), new_markdown_cell("## Part")]
    path = write_notebook(tmp_path / "one.ipynb", *cells)
    text, pictures = pages.convert(path, "one/")
    order = ["# Title", "Subject.", '!!! warning "Without outputs"', "````python\na = '```'\n````", "## Part"]
    assert [text.index(part) for part in order] == sorted(text.index(part) for part in order)
    assert 'href="one/one.ipynb"' in text
    assert (pictures, 'class="result"' in text) == ({}, False)

    notebook = nbformat.read(path, as_version=4)
    notebook.cells[1].outputs = [
        new_output("stream", text="\x1b[31mred\x1b[0m\n"),
        new_output("execute_result", data={"text/html": "<b>certain</b>", "text/plain": "Localization(...)"}),
        new_output("display_data", data={"image/png": base64.b64encode(PNG).decode(), "text/plain": "<Figure>"}),
        new_output("execute_result", data={"text/plain": "[1]"}),
    ]
    notebook.metadata[pages.notebooks.KEY] = pages.notebooks.compute_key(path)
    pages.notebooks.EXECUTED.mkdir()
    nbformat.write(notebook, pages.notebooks.EXECUTED / path.name)
    text, pictures = pages.convert(path, "one/")
    assert pictures == {"1.png": PNG}
    (shown,) = re.findall(r'<div class="result" markdown>\n\n(.*)\n\n</div>', text, re.DOTALL)
    picture = "[![Output 1](one/1.png)](one/1.png)"
    assert shown.split("\n\n") == ["```text\nred\n```", "<b>certain</b>", picture, "```text\n[1]\n```"]
    assert "Without outputs" not in text

    write_notebook(path, cells[0], new_code_cell("a = 2"))
    text, _ = pages.convert(path, "one/")
    assert "certain" not in text
    assert "Without outputs" in text
