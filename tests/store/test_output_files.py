from __future__ import annotations

import pytest

from tactile_loc.core.errors import OutputError
from tactile_loc.store.files import require_writable, write_atomically


def test_a_folder_that_can_be_made_is_fine_and_not_made(tmp_path):
    require_writable(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_way_is_not(tmp_path):
    (tmp_path / "a").write_text("mine")
    for folder in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(OutputError, match="not a folder"):
            require_writable(folder)


def test_a_folder_that_refuses_is_not(tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        require_writable(tmp_path)


def test_writing_makes_the_folder_and_leaves_one_file(tmp_path):
    path = write_atomically(tmp_path / "new" / "a.txt", lambda p: p.write_text("all"))
    assert path.read_text() == "all"
    assert list(path.parent.iterdir()) == [path]


def test_a_write_that_fails_halfway_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def halfway(temporary):
        temporary.write_text("new, ha")
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left on device"):
        write_atomically(path, halfway)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_other_errors_pass_through_and_leave_nothing(tmp_path):
    def broken(temporary):
        temporary.write_text("x")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_atomically(tmp_path / "a.txt", broken)
    assert list(tmp_path.iterdir()) == []
