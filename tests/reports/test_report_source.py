"""A path names one result."""

from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.reports import find_result


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "result.json").write_text("{}")
    return tmp_path


def test_a_folder_or_any_of_its_files_names_the_result(folder):
    (folder / "result.npz").touch()
    for path in (folder, folder / "result.json", folder / "result.npz", folder / "result.png"):
        assert find_result(path) == folder / "result.json"


def test_a_folder_with_several_results_needs_a_file_name(folder):
    (folder / "recall.json").write_text("{}")
    with pytest.raises(ResultError, match=naming("result.json", "recall.json") + r"(?!.*sweep\.json)"):
        find_result(folder)
    assert find_result(folder / "recall.json") == folder / "recall.json"


def test_a_path_without_a_result_gives_a_one_sentence_error(tmp_path):
    with pytest.raises(ResultError, match=naming(tmp_path, "result.json", "sweep.json")):
        find_result(tmp_path)
    with pytest.raises(ResultError, match=naming(tmp_path / "nowhere", "sweep.json")):
        find_result(tmp_path / "nowhere")
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ResultError, match=naming(tmp_path / "notes.txt", "sweep.json")):
        find_result(tmp_path / "notes.txt")
    with pytest.raises(ResultError, match=naming(tmp_path / "result.json")):
        find_result(tmp_path / "result.npz")
    (tmp_path / "results.csv").touch()
    with pytest.raises(ResultError, match=naming(tmp_path, "sweep.json", "touches")):
        find_result(tmp_path)
