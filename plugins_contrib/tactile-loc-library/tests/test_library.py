"""Libraries on disk: changes, readers during changes, damage, and interrupted changes."""

import dataclasses
import os
import shutil
import time

import numpy as np
import pytest
from kill_steps import killed_at_every_step
from library_helpers import FEW, NAMES, flip, read_files
from tactile_loc.plugin import MissingLibraryError

from tactile_loc_library import library as folder
from tactile_loc_library import shards
from tactile_loc_library.building import build_library, list_meshes
from tactile_loc_library.library import Library
from tactile_loc_library.record import LibraryError, PartRecord, require_pyarrow


def rename(record: PartRecord, name: str) -> PartRecord:
    return dataclasses.replace(record, name=name)


@pytest.fixture
def split(library, meshes, monkeypatch) -> Library:
    """The library with at most two parts a shard."""
    largest = max(shards.count_bytes(row) for row in library.rows.values())
    for module in (shards, folder):
        monkeypatch.setattr(module, "SHARD_BYTES", int(2.5 * largest))
    return build_library(library.path, list_meshes([meshes], "mm", "none"), FEW).library


def test_shards_hold_the_vectors_and_placements_of_all_parts(built):
    library = Library.open(built)
    (shard,) = library.shards
    assert isinstance(shard.vectors, np.memmap)
    assert [row.name for row in shard.parts] == list(NAMES)
    assert len(shard.vectors) == len(shard.placements) == sum(row.places for row in library.rows.values())
    for row in shard.parts:
        record, some = library.read(row.name), slice(row.first, row.first + row.places)
        assert np.array_equal(shard.vectors[some], record.vectors)
        assert np.array_equal(shard.placements[some], record.placements)


def test_opening_reads_no_record_and_a_missing_shard_damages_all_its_parts(library):
    for shard in library.shards:
        for path in shard.folder.iterdir():
            path.write_bytes(b"")
    again = Library.open(library.path)
    assert again.names == NAMES
    with pytest.raises(LibraryError, match="library check"):
        again.read("part-0")
    for path in library.shards[0].folder.iterdir():
        path.unlink()
    damage = Library.open(library.path).find_damage()
    assert damage.parts == NAMES
    assert len(damage.files) == 3


def test_parts_are_added_replaced_and_removed(library):
    first = library.read("part-0")
    more = library.add([rename(first, "new"), rename(first, "part-3")])
    assert more.names == ("new", *NAMES)
    assert np.array_equal(more.read("part-3").vectors, first.vectors)
    assert np.array_equal(more.read("part-4").vectors, library.read("part-4").vectors)
    less = more.remove(["new", "part-0"])
    assert less.names == NAMES[1:]
    assert not less.find_damage()
    assert Library.open(library.path).rows == less.rows


def test_a_missing_part_and_a_record_of_another_grid_are_refused(library):
    with pytest.raises(LibraryError, match=r"no part 'part-9' in .*Did you mean"):
        library.remove(["part-9"])
    with pytest.raises(LibraryError, match="no part 'nothing'"):
        library.read("nothing")
    other = dataclasses.replace(library.read("part-0"), grid={"name": "whole", "options": {"directions": 9}})
    with pytest.raises(LibraryError, match="other places or vectors"):
        library.add([other])


def test_shards_are_closed_before_they_grow_too_large_and_an_added_part_leaves_full_ones_alone(split):
    assert [len(shard.parts) for shard in split.shards] == [2, 2, 2]
    assert sorted(row.name for shard in split.shards for row in shard.parts) == list(NAMES)
    assert not split.find_damage()
    more = split.add([rename(split.read("part-0"), "part-9")])
    assert {shard.entry.name for shard in split.shards} < {shard.entry.name for shard in more.shards}


def test_shards_of_removed_parts_are_written_again_when_they_are_half_empty(split):
    one, two = (shard.parts[0].name for shard in split.shards[:2])
    left = split.remove([one, two])
    assert all(shard.entry.parts == len(shard.parts) for shard in left.shards)
    assert len(left.shards) == 2
    assert not left.find_damage()


def test_a_reader_keeps_its_library_while_others_change_it(library):
    reader = Library.open(library.path)
    wanted = {name: library.read(name).vectors.copy() for name in NAMES}
    library.remove(NAMES[:5]).add([rename(library.read("part-5"), "new")]).remove(["part-5"])
    for name in NAMES:
        assert np.array_equal(reader.read(name).vectors, wanted[name])
    assert Library.open(library.path).names == ("new",)


@pytest.mark.slow
def test_a_reader_sees_whole_libraries_during_changes(library, tmp_path):
    """Another process adds and removes a part in turn, while this one opens the library and reads the part."""
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    writer = context.Process(target=change_often, args=(library.path, stop))
    writer.start()
    seen: set[tuple[str, ...]] = set()
    try:
        limit_s = time.monotonic() + 600
        while len(seen) < 2 and time.monotonic() < limit_s:
            now = Library.open(library.path)
            seen.add(now.names)
            for name in now.names:
                now.read(name)
    finally:
        stop.set()
        writer.join()
    assert writer.exitcode == 0
    assert seen == {NAMES, ("new", *NAMES)}


@pytest.mark.slow
def test_two_processes_that_add_parts_at_once_wait_for_each_other(library):
    import multiprocessing

    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=add_some, args=(library.path, letter)) for letter in "ab"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    now = Library.open(library.path)
    assert now.names == (*(f"{letter}-{k}" for letter in "ab" for k in range(5)), *NAMES)
    assert not now.find_damage()


def add_some(path, letter: str) -> None:
    library = Library.open(path)
    record = library.read("part-0")
    for k in range(5):
        library.add([rename(record, f"{letter}-{k}")])


@pytest.mark.slow
@pytest.mark.parametrize("change", ["add", "remove"])
def test_a_change_that_is_killed_at_any_step_leaves_the_old_or_the_new_library(built, tmp_path, change):
    before = read_files(built)
    path = tmp_path / "library"
    record = rename(Library.open(built).read("part-0"), "new")
    names = ("new", *NAMES) if change == "add" else NAMES[1:]

    def act() -> None:
        opened = Library.open(path)
        if change == "add":
            opened.add([record])
        else:
            opened.remove(["part-0"])

    shutil.copytree(built, path)
    seen = set()
    for _ in killed_at_every_step(act):
        now = Library.open(path)
        seen.add(now.names)
        assert not now.find_damage()
        if now.names == NAMES:
            act()
        assert Library.open(path).names == names
        assert {name for name in read_files(path) if name.startswith(".tmp") or "/.tmp" in name} == set()
        shutil.rmtree(path)
        shutil.copytree(built, path)
    assert seen == {NAMES, names}
    assert read_files(path) == before


def change_often(path, stop) -> None:
    library = Library.open(path)
    new = rename(library.read("part-0"), "new")
    while not stop.is_set():
        library.add([new])
        library.remove(["new"])


def test_unused_files_are_deleted_after_a_while(library):
    old = library.shards[0].folder
    less = library.remove(["part-0"])
    assert old.is_dir()
    for path in (old, library.path / library.manifest.table):
        os.utime(path, (time.time() - folder.GRACE_S - 1,) * 2)
    last = less.remove(["part-1"])
    assert not old.exists()
    assert not (library.path / library.manifest.table).exists()
    assert not last.find_damage()
    assert less.shards[0].folder.is_dir()  # a reader may still use it


@pytest.mark.parametrize("step", ["write_shards", "write_table", "replace_file", "_delete_unused"])
def test_a_change_that_fails_leaves_the_old_or_the_new_library(library, monkeypatch, step):
    def fail(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(folder, step, fail)
    with pytest.raises(KeyboardInterrupt):
        library.remove(["part-0"])
    monkeypatch.undo()
    now = Library.open(library.path)
    assert now.names == (NAMES[1:] if step == "_delete_unused" else NAMES)
    assert not now.find_damage()
    assert library.remove(["part-1"]).names == tuple(name for name in now.names if name != "part-1")


@pytest.mark.parametrize("name", ["records.bin", "placements.npy", "vectors.npy"])
def test_damage_is_found_in_the_part_that_has_it(library, name):
    (shard,) = library.shards
    flip(shard.folder / name, -1)
    damage = Library.open(library.path).find_damage()
    assert damage.parts == ("part-5",)
    assert list(damage.files) == [f"shards/{shard.entry.name}/{name}"]
    again = Library.open(library.path)
    with pytest.raises(LibraryError, match=r"part-5 .*checksum; .*library check"):
        again.read("part-5")
    again.read("part-4")


def test_a_damaged_part_can_be_removed_or_replaced(library):
    record = library.read("part-5")
    flip(library.shards[0].folder / "vectors.npy", -1)
    damaged = Library.open(library.path)
    assert not damaged.add([record]).find_damage()
    flip(Library.open(library.path).shards[0].folder / "vectors.npy", -1)
    assert not Library.open(library.path).remove(["part-5"]).find_damage()


@pytest.mark.parametrize("name", ["library.json", "table"])
def test_a_damaged_manifest_or_table_is_refused(library, name):
    path = library.path / (library.manifest.table if name == "table" else name)
    flip(path, 40)
    with pytest.raises(LibraryError, match="build the library again"):
        Library.open(library.path)
    path.unlink()
    with pytest.raises(LibraryError, match=r"library build|build the library again"):
        Library.open(library.path)


def test_a_library_of_another_format_is_refused(library):
    path = library.path / "library.json"
    path.write_text(path.read_text().replace('"schema_version": 1', '"schema_version": 99'))
    with pytest.raises(LibraryError, match="format 99, not 1; build the library again"):
        Library.open(library.path)


def test_without_pyarrow_the_command_to_install_it_is_stated(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingLibraryError, match=r"pip install pyarrow"):
        require_pyarrow()
