"""Checks of the files that a command leaves: broken files, finished work, leftovers, and the answer."""

import csv
import hashlib
import json
import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from tactile_loc_library.building import WAITING
from tactile_loc_library.library import MANIFEST as LIBRARY

from killing.commands import Place
from tactile_loc import Recording, StageStore, TactileLocError
from tactile_loc.store.artifact import MANIFEST, read_artifact
from tactile_loc.store.keys import hash_file

STAGE = "store: "  # prefix of stages in an answer
BESIDE = ".tmp-"  # prefix of files that are not yet in their place
LINES = (".jsonl", ".journal")
UNREADABLE = (OSError, ValueError, LookupError, EOFError, SyntaxError, zipfile.BadZipFile, zlib.error, TactileLocError)
CLOCKED = re.compile(
    r"result_sha256|seconds|created|versions|duration|time_s|^built$|_ms$|^time_|_s$|distributions|^(key|source|path)$"
)  # keys and files whose content depends on the clock, the number of starts, or the folder
DRAWN = (".png", ".html", ".md", ".parquet", ".log", ".toml")  # files that are not compared, such as pictures


def find_broken(place: Place, ended: bool) -> list[str]:
    """Return a finding for each unreadable file. An incomplete line is a fault only if the command `ended`."""
    found = []
    for entry in StageStore(place.store).entries():
        try:
            if entry.complete:
                artifact = read_artifact(entry.path)
                artifact.read_signature()
                artifact.verify()
        except TactileLocError as error:
            found.append(f"artifact {entry.stage}: {error}")
    for path in _list_files(place):
        try:
            _read_timeless(path, ended)
        except UNREADABLE as error:
            found.append(f"{path.relative_to(place.root)}: {type(error).__name__}: {error}")
    return found


def list_finished(place: Place) -> set[str]:
    """Return a text for each finished artifact, piece, line and row. Doing the work again gives another text."""
    found = set()
    for entry in StageStore(place.store).entries():
        manifest = entry.path / MANIFEST
        if manifest.is_file():  # also before the folder is renamed
            found.add(f"artifact {entry.stage}/{entry.digest} of {manifest.stat().st_mtime_ns}")
        elif (pieces := entry.path / ".pieces.json").is_file():  # the next build takes the whole ones
            for name, sums in json.loads(pieces.read_text(encoding="utf-8")).items():
                if (entry.path / name).is_file() and hash_file(entry.path / name) in sums:
                    found.add(f"piece {entry.stage}/{entry.digest}/{name}")
    for path in _list_files(place):
        if path.parent.name == WAITING and not path.suffix:
            found.add(f"part {path.name} of {path.stat().st_mtime_ns}")
        elif path.suffix in LINES:
            found |= {f"line {path.name} {number} {_digest(line)}" for number, line in enumerate(_read_lines(path))}
        elif path.parent.name == "rows" and not json.loads(path.read_text(encoding="utf-8"))["error"]:
            found.add(f"row {path.stem} of {path.stat().st_mtime_ns}")
    return found


def find_lost(before: set[str], after: set[str], place: Place) -> list[str]:
    """Return the work that was finished `before` and is missing `after`, unless a finished file has replaced it."""
    artifacts = {word.split()[1] for word in after if word.startswith("artifact ")}
    return sorted(word for word in before - after if not _is_replaced(word, artifacts, place))


def _is_replaced(word: str, artifacts: set[str], place: Place) -> bool:
    """Return whether the finished file exists: the artifact of a piece, the library, or the result of a journal."""
    kind, name, *_ = word.split()
    if kind == "piece":
        return name.rsplit("/", 1)[0] in artifacts
    if kind == "part":
        return any(path.name == LIBRARY for path in _list_files(place))
    return kind == "line" and name.endswith(".journal") and (place.work / name.removesuffix(".journal")).exists()


def list_leftovers(place: Place) -> list[str]:
    """Return the files and folders that a finished command should have deleted, with HEX for random names."""
    found = []
    for root in (place.work, place.store):
        left = [path.relative_to(root) for path in root.rglob("*") if _is_left(path)]
        found += [path.name for path in left if not any(map(_is_left, path.parents))]
    found += [path.name for path in place.temporary.iterdir() if path.name != "dask-scratch-space"]
    found += [f"dask {path.name}" for path in place.temporary.glob("dask-scratch-space/*") if path.is_dir()]
    return sorted(re.sub(r"[0-9a-f]{16,}", "HEX", name) for name in found)


def count_locks(place: Place) -> int:
    """Return the number of lock files."""
    return len(list(place.store.glob("*/*.lock")))


def digest_answer(place: Place) -> dict[str, str]:
    """Return a digest of each result, by the result's name. Times have no influence."""
    found = {}
    for entry in StageStore(place.store).entries():
        if entry.complete:
            records = read_artifact(entry.path).files.items()
            kept = sorted((name, one.sha256) for name, one in records if not CLOCKED.search(name.partition(".")[0]))
            found[f"{STAGE}{entry.stage}/{entry.digest}"] = _digest(json.dumps(kept))
    for path in _list_files(place):
        if path.suffix not in DRAWN and path.parent.name != "rows" and place.store not in path.parents:
            found[str(path.relative_to(place.work))] = _digest(_read_timeless(path))
    return found


def _is_left(path: Path) -> bool:
    """Return whether only an unfinished command needs a file or folder."""
    return path.name.startswith(BESIDE) or path.suffix in (".partial", ".journal")


def _list_files(place: Place) -> Iterator[Path]:
    """Yield the files of the working folder and of the store, without locks and temporary files."""
    for root in (place.work, place.store):
        for path in sorted(root.rglob("*")):
            beside = any(part.startswith(BESIDE) for part in path.relative_to(root).parts)
            if path.is_file() and not beside and path.suffix != ".lock":
                yield path


def _read_lines(path: Path) -> list[bytes]:
    """Return the complete lines of a file."""
    return [line for line in path.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]


def _read_timeless(path: Path, ended: bool = True) -> str:
    """Return the content of a file without times. Raises one of `UNREADABLE` if the file is incomplete."""
    text = path.read_bytes()
    if path.suffix in (".csv", ".md", ".html", *(LINES if ended else ())) and not (b"\n" + text).endswith(b"\n"):
        raise ValueError("ends in half a line")
    if path.suffix == ".json":
        return json.dumps(_drop_times(json.loads(text)))
    if path.suffix in LINES:  # each run appends to a .jsonl file; only the last line of each name counts
        records = [_drop_times(json.loads(line)) for line in _read_lines(path)]
        return json.dumps({record["name"]: record for record in records} if path.suffix == ".jsonl" else records)
    if path.suffix == ".csv":
        return json.dumps(_drop_times(list(csv.DictReader(text.decode().splitlines()))))
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            return json.dumps(_drop_times({name: _digest(file[name].tobytes()) for name in sorted(file)}))
    if path.suffix == ".npy":
        np.load(path, allow_pickle=False)
    elif path.suffix == ".png":
        Image.open(path).load()
    elif path.suffix == ".mcap" and (damage := Recording(path).read_contents().damage):
        raise ValueError(damage)
    return text.hex()


def _drop_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _drop_times(item) for key, item in value.items() if not CLOCKED.search(key)}
    return [_drop_times(item) for item in value] if isinstance(value, list) else value


def _digest(text: str | bytes) -> str:
    return hashlib.sha256(text if isinstance(text, bytes) else text.encode()).hexdigest()[:16]
