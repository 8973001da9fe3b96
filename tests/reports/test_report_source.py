"""A path names one result."""

from __future__ import annotations

from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.reports import find_source


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "result.json").write_text("{}")
    return tmp_path


def test_a_folder_or_any_of_its_files_names_the_result(folder):
    (folder / "result.npz").touch()
    for path in (folder, folder / "result.json", folder / "result.npz", folder / "result.png"):
        source = find_source(path)
        assert (source.kind, source.path) == ("run", folder / "result.json")


@pytest.mark.parametrize(
    ("name", "kind"), [("results.json", "evaluation"), ("contacts.json", "contacts"), ("sweep.json", "sweep")]
)
def test_the_file_determines_the_kind(tmp_path, name, kind):
    (tmp_path / name).write_text("{}")
    assert find_source(tmp_path).kind == kind


def test_a_folder_with_several_results_needs_a_file_name(folder):
    (folder / "contacts.json").write_text("{}")
    with pytest.raises(ResultError, match=naming("result.json", "contacts.json") + r"(?!.*sweep\.json)"):
        find_source(folder)
    assert find_source(folder / "contacts.json").kind == "contacts"


def test_a_path_without_a_result_gives_a_one_sentence_error(tmp_path):
    with pytest.raises(ResultError, match=naming(tmp_path, "result.json", "sweep.json")):
        find_source(tmp_path)
    with pytest.raises(ResultError, match=naming(tmp_path / "nowhere", "sweep.json")):
        find_source(tmp_path / "nowhere")
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ResultError, match=naming(tmp_path / "notes.txt", "sweep.json")):
        find_source(tmp_path / "notes.txt")
    with pytest.raises(ResultError, match=naming(tmp_path / "result.json")):
        find_source(tmp_path / "result.npz")
    (tmp_path / "results.csv").touch()
    with pytest.raises(ResultError, match=naming(tmp_path, "sweep.json", "touches")):
        find_source(tmp_path)
