"""Files that grow by lines hold whole lines only, after any interruption."""

import errno
import json
import os
from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.store.line_files import open_json_lines


def values(path: Path) -> list[int]:
    return [json.loads(line)["n"] for line in path.read_text().splitlines()]


def add(path: Path, *numbers: int) -> None:
    with open_json_lines(path) as add_line:
        for number in numbers:
            add_line(json.dumps({"n": number}))


def test_lines_are_written_at_once_and_can_be_appended(tmp_path):
    path = tmp_path / "new" / "a.jsonl"
    with open_json_lines(path) as add_line:
        add_line('{"n": 1}')
        assert values(path) == [1]
    add(path, 2, 3)
    assert values(path) == [1, 2, 3]


@pytest.mark.parametrize(("last", "expected"), [('{"n": 2', [1, 3]), ('{"n": 2}', [1, 2, 3]), ("", [1, 3])])
def test_an_incomplete_line_is_removed_and_a_complete_one_is_kept(tmp_path, last, expected):
    path = tmp_path / "a.jsonl"
    path.write_text('{"n": 1}\n' + last)
    add(path, 3)
    assert values(path) == expected


def test_a_full_disk_leaves_whole_lines(tmp_path, monkeypatch):
    path, write = tmp_path / "a.jsonl", os.write

    def full(descriptor: int, text: bytes) -> int:
        if len(text) > 3:
            return write(descriptor, text[:-3])
        raise OSError(errno.ENOSPC, "No space left on device")

    add(path, 1)
    with open_json_lines(path) as add_line, monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OutputError, match=naming("a.jsonl", "No space left", "`out`")):
            add_line('{"n": 2}')
    assert values(path) == [1]


def test_two_writers_and_impossible_paths_are_refused(tmp_path):
    path = tmp_path / "a.jsonl"
    refused = pytest.raises(OutputError, match=naming("a.jsonl", "process", "`out`"))
    with open_json_lines(path), refused, open_json_lines(path):
        pass
    (tmp_path / "file").write_text("")
    refused = pytest.raises(OutputError, match=naming("file/a.jsonl", "`out`"))
    with refused, open_json_lines(tmp_path / "file" / "a.jsonl"):
        pass
