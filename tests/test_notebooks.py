"""The notebooks of docs/notebooks: each is in git without outputs, explains itself, and runs without an error."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
NAMES = [path.stem for path in NOTEBOOKS]
PAGE = (ROOT / "docs" / "examples.md").read_text()
LONGEST_CELL = 25  # lines


@pytest.fixture
def notebooks():
    return pytest.importorskip("notebooks")  # in scripts


@pytest.fixture(params=NOTEBOOKS, ids=NAMES)
def source(request) -> nbformat.NotebookNode:
    return nbformat.read(request.param, as_version=4)


def code_of(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_there_are_five_notebooks_and_the_page_lists_them():
    assert len(NAMES) == 5
    assert re.findall(r"\]\(notebooks/([\w-]+)\.ipynb\)", PAGE) == sorted(NAMES, key=PAGE.index)


def test_a_notebook_is_valid_and_has_no_outputs(source):
    nbformat.validate(source)
    assert all(not cell.outputs and cell.execution_count is None for cell in code_of(source))
    assert source.metadata.kernelspec.name == "python3"


def test_a_notebook_begins_with_its_subject_and_the_installation(source):
    first, second = source.cells[:2]
    assert first.cell_type == "markdown"
    assert re.match(r"# .+\n\n.+", first.source)
    assert 'find_spec("tactile_loc") is None' in second.source
    assert "%pip install" in second.source


def test_a_notebook_has_short_cells_and_no_paths_of_a_machine(source):
    assert all(len(cell.source.splitlines()) <= LONGEST_CELL for cell in source.cells)
    assert not re.search(r"/(home|tmp|work|root|Users)/", "".join(cell.source for cell in source.cells))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_and_shows_its_results(notebooks, name, monkeypatch, store):
    """The executed notebook stays in out/notebooks, where `make docs` finds it."""
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    monkeypatch.setenv("PYTHONPATH", ":".join([str(ROOT), str(ROOT / "cli")]))
    path = ROOT / "docs" / "notebooks" / f"{name}.ipynb"
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


def write_notebook(path: Path, code: str) -> Path:
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(code)]), path)
    return path


def test_an_error_in_a_cell_is_reported(notebooks, elsewhere, capsys):
    path = write_notebook(elsewhere / "broken.ipynb", "1 / 0")
    assert notebooks.main() == 1
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert notebooks.read_executed(path) is None


def test_only_changed_notebooks_are_executed(notebooks, elsewhere, monkeypatch):
    executed = []

    def execute(path: Path) -> nbformat.NotebookNode:
        executed.append(path.stem)
        return nbformat.read(path, as_version=4)

    monkeypatch.setattr(notebooks, "execute", execute)
    first, _ = (write_notebook(elsewhere / f"{name}.ipynb", "1") for name in ("first", "second"))
    assert notebooks.main() == 0
    assert executed == ["first", "second"]
    assert notebooks.main() == 0
    assert executed == ["first", "second"]
    write_notebook(first, "2")
    assert notebooks.read_executed(first) is None
    notebooks.main()
    assert executed[2:] == ["first"]
    monkeypatch.setattr(sys, "argv", ["notebooks.py", "--again", "second"])
    notebooks.main()
    assert executed[3:] == ["second"]


def test_a_change_of_the_package_makes_executed_notebooks_old(notebooks, elsewhere):
    path, module = write_notebook(elsewhere / "one.ipynb", "1"), elsewhere.parent / "tactile_loc" / "module.py"
    keys = {notebooks.compute_key(path)}
    module.parent.mkdir()
    for text in ("a = 1", "a = 2"):
        module.write_text(text)
        notebooks._hash_package.cache_clear()
        keys.add(notebooks.compute_key(path))
    assert len(keys) == 3
