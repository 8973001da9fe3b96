import os
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest
from kill_steps import killed_at_every_step
from message_helpers import naming

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.store import files, locks
from tactile_loc.store.files import (
    link_plainly,
    list_files,
    lock_folder,
    read_json,
    recover_folder,
    remove_abandoned,
    replace_folder,
    require_writable,
    write_atomically,
    write_json,
    write_text,
)


@pytest.fixture(params=["here", "windows"])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The system of this machine, or one that, like Windows, opens no folders and deletes no open files."""
    delete = os.unlink

    def refuse_open_files(path: Path, *, dir_fd: int | None = None) -> None:
        there = os.lstat(path, dir_fd=dir_fd)
        for descriptor in range(3, 64):
            with suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), there):
                    break
        else:
            return delete(path, dir_fd=dir_fd)
        raise PermissionError(13, "Permission denied", str(path))

    if request.param == "windows":
        monkeypatch.setattr(locks, "OPENS_FOLDERS", False)
        monkeypatch.setattr(os, "unlink", refuse_open_files)
    return request.param


def test_a_file_in_place_of_a_folder_is_refused(tmp_path):
    (tmp_path / "a").write_text("mine")
    for folder in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(OutputError, match=naming(tmp_path / "a", "`out`")):
            require_writable(folder)
    with pytest.raises(OutputError, match=naming(tmp_path / "a", "`out`")), lock_folder(tmp_path / "a"):
        pass


def test_a_folder_without_write_permission_is_refused(tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(OutputError, match=naming(tmp_path, "Permission denied", "`out`")):
        require_writable(tmp_path)


@pytest.mark.parametrize(
    ("reason", "error", "words"),
    [
        (OSError(28, "No space left on device"), OutputError, ["a.txt", "No space left", "`out`"]),
        (ZeroDivisionError("by zero"), ZeroDivisionError, ["by zero"]),
    ],
)
@pytest.mark.parametrize("old", ["old", None])
def test_a_write_that_fails_halfway_leaves_the_old_file_or_nothing(tmp_path, reason, error, words, old):
    path = tmp_path / "a.txt"
    if old:
        path.write_text(old)

    def halfway(temporary):
        temporary.write_text("new, ha")
        raise reason

    with pytest.raises(error, match=naming(*words)):
        write_atomically(path, halfway)
    assert [one.read_text() for one in tmp_path.iterdir()] == ([old] if old else [])


def test_a_folder_that_accepts_no_files_is_refused_and_a_dangling_link_does_not_block_writing(tmp_path):
    with pytest.raises(OutputError, match=naming("/proc/a.txt", "`out`")):
        write_atomically(Path("/proc/a.txt"), lambda temporary: temporary.write_text("x"))
    (tmp_path / ".tmp-new-a.txt").symlink_to(tmp_path / "nowhere")
    assert write_atomically(tmp_path / "a.txt", lambda temporary: temporary.write_text("x")).read_text() == "x"


def test_json_is_written_readably_and_read_back(tmp_path):
    value = {"name": "µm", "poses": [1.5, None]}
    path = write_json(tmp_path / "new" / "a.json", value)
    assert read_json(path) == value
    lines = path.read_text(encoding="utf-8").split("\n")
    assert len(lines) > 4
    assert lines[-1] == ""
    for encoding in ("utf-8-sig", "utf-16"):  # of other editors
        path.write_text('{"a": "ü"}', encoding=encoding, newline="\r\n")
        assert read_json(path) == {"a": "ü"}


def test_a_killed_process_leaves_the_old_or_the_new_file_and_the_next_write_cleans_up(tmp_path, system):
    path, seen, left = tmp_path / "a.txt", [], 0
    path.write_text("old")
    for _ in killed_at_every_step(lambda: write_atomically(path, lambda p: p.write_text("new"))):
        seen.append(path.read_text())
        left += len(names(tmp_path)) > 1
        write_atomically(path, lambda p: p.write_text("old"))
        assert names(tmp_path) == ["a.txt"]
    assert set(seen) == {"old", "new"}
    assert left > 3


def test_a_write_does_not_affect_another_process_at_the_same_file(tmp_path, system):
    path = tmp_path / "a.txt"
    with files.replace_file(path) as slow:
        slow.write_text("slow")
        for _ in killed_at_every_step(lambda: write_atomically(path, lambda p: p.write_text("fast"))):
            assert slow.read_text() == "slow"
        assert path.read_text() == "fast"
    assert path.read_text() == "slow"
    assert names(tmp_path) == ["a.txt"]


def test_only_remains_of_killed_processes_are_removed(tmp_path, system):
    (tmp_path / ".tmp-new-a.txt").mkdir()
    (tmp_path / f".tmp-{'0' * 32}-b.txt").mkdir()
    (tmp_path / f".tmp-{'0' * 32}-b.txt" / "b.txt").touch()
    (tmp_path / ".tmp-old-c").mkdir()  # a folder that was set aside, possibly the only complete one
    (tmp_path / "d.txt").touch()

    def while_writing(temporary):
        remove_abandoned(tmp_path)
        temporary.write_text("x")

    write_atomically(tmp_path / "e.txt", while_writing)
    assert sorted(names(tmp_path)) == [".tmp-old-c", "d.txt", "e.txt"]
    remove_abandoned(tmp_path / "none")


def test_a_lock_gives_exclusive_access_to_a_folder(tmp_path, system):
    folder, seen = tmp_path / "new" / "folder", []

    def write(number):
        with lock_folder(folder):
            for name in "ab":
                (folder / name).write_text(str(number))
                time.sleep(0.005)
            seen.append({(folder / name).read_text() for name in "ab"})

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(8)))
    assert sorted(map(sorted, seen)) == [[str(number)] for number in range(8)]
    assert sorted(names(folder)) == ([locks.IN_FOLDER] if system == "windows" else []) + ["a", "b"]


NAMES = ("a.txt", "deep/b.txt")


def replace(folder: Path, text: str, **options: bool) -> None:
    with replace_folder(folder, **options) as new:
        (new / "deep").mkdir()
        for name in NAMES:
            (new / name).write_text(text)


def text(folder: Path) -> str:
    """Return the text that all files of a folder share."""
    (found,) = {(folder / name).read_text() for name in NAMES}
    assert sum(path.is_file() for path in folder.rglob("*")) == len(NAMES)
    return found


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


@pytest.fixture(params=["exchange", "by a third place"])
def any_file_system(request, monkeypatch):
    if request.param != "exchange":
        monkeypatch.setattr(files, "_exchange", lambda one, other: False)


def test_linux_exchanges_two_folders_at_once(tmp_path):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).touch()
    if not files._exchange(tmp_path / "one", tmp_path / "other"):
        pytest.skip("this file system does not exchange folders")
    assert names(tmp_path / "one") == ["other"]
    assert not files._exchange(tmp_path / "one", tmp_path / "none")


@pytest.mark.usefixtures("any_file_system")
def test_a_killed_process_leaves_the_old_or_the_new_folder(tmp_path):
    folder, seen = tmp_path / "folder", []
    replace(folder, "old")
    for _ in killed_at_every_step(lambda: replace(folder, "new")):
        recover_folder(folder)
        seen.append(text(folder))
        replace(folder, "old")
        assert names(tmp_path) == ["folder"]
    steps = seen.count("old")
    assert steps > 8
    assert seen == ["old"] * steps + ["new"] * (len(seen) - steps)
    assert len(seen) > steps + 8  # a kill during the removal of the old folder is included


def test_a_folder_set_aside_is_restored_before_a_replacement(tmp_path):
    replace(tmp_path / "folder", "old")
    (tmp_path / "folder").rename(files._name_aside(tmp_path / "folder"))
    with pytest.raises(ZeroDivisionError), replace_folder(tmp_path / "folder"):
        raise ZeroDivisionError
    assert text(tmp_path / "folder") == "old"
    assert names(tmp_path) == ["folder"]


@pytest.mark.parametrize("fails", ["os.fsync", "os.rename", "pathlib.Path.rename"])
def test_a_disk_error_leaves_the_old_folder(tmp_path, monkeypatch, fails):
    replace(tmp_path / "folder", "old")

    def refuse(*_: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(fails, refuse)
    monkeypatch.setattr(files, "_exchange", lambda one, other: False)
    with pytest.raises(OSError, match="Input/output"):
        replace(tmp_path / "folder", "new")
    assert text(tmp_path / "folder") == "old"
    assert names(tmp_path) == ["folder"]


def test_a_failure_of_the_second_rename_leaves_the_old_folder(tmp_path, monkeypatch):
    folder, rename = tmp_path / "folder", Path.rename
    replace(folder, "old")

    def refuse(self: Path, target: Path) -> Path:
        if target == folder and self != files._name_aside(folder):
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(files, "_exchange", lambda one, other: False)
    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(OSError, match="Input/output"):
        replace(folder, "new")
    assert text(folder) == "old"
    assert names(tmp_path) == ["folder"]


def test_a_replacement_does_not_affect_another_writing_process(tmp_path):
    with replace_folder(tmp_path / "folder") as slow:
        (slow / "a.txt").write_text("slow")
        replace(tmp_path / "folder", "fast")
        assert (slow / "a.txt").read_text() == "slow"
    assert names(tmp_path / "folder") == ["a.txt"]
    assert names(tmp_path) == ["folder"]


def test_the_target_of_a_link_is_replaced(tmp_path):
    replace(tmp_path / "there" / "folder", "old")
    (tmp_path / "link").symlink_to(tmp_path / "there" / "folder")
    replace(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert text(tmp_path / "there" / "folder") == "new"


def test_a_fresh_folder_never_replaces_another_folder(tmp_path):
    replace(tmp_path / "folder", "old")
    with pytest.raises(OSError, match="not empty"):
        replace(tmp_path / "folder", "new", fresh=True)
    assert text(tmp_path / "folder") == "old"
    assert names(tmp_path) == ["folder"]
    replace(tmp_path / "other", "new", fresh=True)
    assert text(tmp_path / "other") == "new"


def test_files_may_have_the_longest_names_and_names_that_are_not_unicode(tmp_path):
    for name in ("x" * 255, os.fsdecode(b"\xe4" * 255), "-a[red]\n%s"):
        path = tmp_path / name
        for text in ("first", "second \udce4"):
            write_text(path, text)
        assert path.read_text(encoding="utf-8") == r"second \xe4"
        with link_plainly(path) as plain:
            assert plain.read_bytes() == path.read_bytes()
            str(plain).encode()
    assert len(list(tmp_path.iterdir())) == 3


def test_visible_files_are_listed_as_people_count(tmp_path):
    for name in ("f10.png", "f2.PNG", "f02.png", "._f1.png", ".f1.png", "f1.txt", "2.png", "f.png"):
        (tmp_path / name).touch()
    (tmp_path / "f3.png").mkdir()
    assert [path.name for path in list_files(tmp_path, {".png"})] == ["2.png", "f.png", "f02.png", "f2.PNG", "f10.png"]
    assert [path.name for path in list_files(tmp_path, {".png"}, "f*.png")] == ["f.png", "f02.png", "f10.png"]
    with pytest.raises(FileNotFoundError):
        list_files(tmp_path / "none", {".png"})
