"""Uploaded files and archives: limits, names, damaged archives, and paths that lead out of them."""

import io
import stat
import zipfile

import pytest

from tactile_loc_app import uploads
from tactile_loc_app.errors import AppError
from tactile_loc_app.uploads import read_files, unpack_upload, write_upload


def pack(files: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return file.getvalue()


@pytest.mark.parametrize("name", ["../part.stl", "/etc/part.stl", "..\\part.stl"])
def test_an_uploaded_file_stays_in_its_folder(tmp_path, name):
    assert write_upload(tmp_path, name, b"x") == tmp_path / "part.stl"


@pytest.mark.parametrize("name", ["", "..", "a/..", "a\0b.stl", ".a.stl", "ö" * 126 + ".stl"])
def test_an_upload_needs_a_name_that_files_can_have(tmp_path, name):
    with pytest.raises(AppError):
        write_upload(tmp_path, name, b"x")


def test_a_large_file_is_refused_alone_and_in_an_archive(tmp_path, monkeypatch):
    monkeypatch.setattr(uploads, "LARGEST_MB", 1)
    assert write_upload(tmp_path, "part.stl", bytes(1_000_000)).stat().st_size == 1_000_000
    with pytest.raises(AppError, match="1 MB"):
        write_upload(tmp_path, "other.stl", bytes(1_000_001))
    with pytest.raises(AppError):
        list(read_files("many.zip", bytes(1_000_001)))
    with pytest.raises(AppError, match="1 MB"):
        unpack_upload(tmp_path / "in", "some.zip", pack({"large.txt": bytes(1_000_001)}))
    assert not (tmp_path / "other.stl").exists()


def test_an_archive_is_unpacked_with_its_folders_and_without_hidden_files(tmp_path):
    content = pack({"a/b.txt": b"1", "12:30.txt": b"2", "__MACOSX/._c.txt": b"3", "a/.DS_Store": b"4"})
    unpacked = unpack_upload(tmp_path, "some.ZIP", content)
    found = {path.relative_to(tmp_path).as_posix(): path.read_bytes() for path in unpacked}
    assert found == {"a/b.txt": b"1", "12:30.txt": b"2"}
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == ["12:30.txt", "b.txt"]


def make_link() -> zipfile.ZipInfo:
    link = zipfile.ZipInfo("link.txt")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    return link


@pytest.mark.parametrize(
    "entry", [["zero_byte.txt"], [make_link()], ["good.txt"]], ids=["zero byte", "symbolic link", "same name"]
)
def test_an_entry_that_is_no_plain_file_is_refused(tmp_path, entry):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("good.txt", b"1")
        for one in entry:
            archive.writestr(one, b"23")
    content = file.getvalue().replace(b"zero_byte", b"zero\0byte")
    with pytest.raises(AppError):
        unpack_upload(tmp_path / "in", "some.zip", content)
    assert not list(tmp_path.rglob("*"))


def test_names_of_too_many_entries_are_not_read(monkeypatch):
    monkeypatch.setattr(uploads, "MOST_ENTRIES", 3)
    monkeypatch.setattr(zipfile, "ZipFile", None)
    with pytest.raises(AppError, match="3"):
        list(read_files("some.zip", b"PK\x01\x02" * 4))


def test_a_stated_size_that_is_wrong_is_refused(tmp_path):
    content = pack({"a.txt": bytes(500)})
    assert content.count((500).to_bytes(4, "little")) == 2
    with pytest.raises(AppError):
        unpack_upload(tmp_path, "some.zip", content.replace((500).to_bytes(4, "little"), (3).to_bytes(4, "little")))


@pytest.mark.parametrize("name", ["../out.txt", "/out.txt", ".", "a/../../out.txt", "..\\out.txt", "C:\\out.txt"])
def test_a_path_that_leads_out_of_an_archive_is_refused(tmp_path, name):
    with pytest.raises(AppError):
        unpack_upload(tmp_path / "in", "some.zip", pack({"good.txt": b"1", name: b"2"}))
    assert not list(tmp_path.rglob("*.txt"))


@pytest.mark.parametrize(("limit", "value"), [("UNPACKED_MB", 1), ("MOST_FILES", 2)])
def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch, limit, value):
    monkeypatch.setattr(uploads, limit, value)
    content = pack({f"{n}.txt": bytes(400_000) for n in range(3)})
    assert len(content) < 10_000
    with pytest.raises(AppError, match=str(value)):
        unpack_upload(tmp_path, "bomb.zip", content)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content",
    [b"", b"no archive", pack({}), pack({"a.txt": bytes(5000)})[:60]],
    ids=["nothing", "text", "empty", "cut"],  # an archive has the time in it, so its bytes are no name of a test
)
def test_a_damaged_or_empty_archive_is_refused(tmp_path, content):
    with pytest.raises(AppError):
        unpack_upload(tmp_path, "some.zip", content)
