"""What a command leaves: what of it is broken, what is finished, what should not be there, and what the answer is."""

from __future__ import annotations

import csv
import hashlib
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from killing.commands import Place
from tactile_loc.core.errors import TactileLocError
from tactile_loc.io.recordings import Recording
from tactile_loc.store.artifact import MANIFEST, read_artifact
from tactile_loc.store.keys import hash_file
from tactile_loc.store.store import Entry, StageStore

STAGE = "store: "  # before the names of stages in what commands answer
BESIDE = ".tmp-"  # with which all begins that is written beside its place
LINES = (".jsonl", ".journal")
JOURNALS = "sweep-builds"
CLOCKED = re.compile(
    r"result_sha256|seconds|created|versions|duration|time_s|^built$|_ms$|^time_|_s$|distributions|^(key|source|path)$"
)  # what depends on the clock, on how often a command was begun, or on the folder it was begun in
DRAWN = (".png", ".html", ".md", ".parquet", ".log", ".toml")  # what people look at, or holds the same again: as rows


def broken(place: Place, ended: bool) -> list[str]:
    """Return what cannot be read of what stands in the place; of a command that `ended` also half lines are wrong."""
    found = [f"artifact {entry.stage}: {error}" for entry in _entries(place) if (error := _damage(entry))]
    for path in _files(place):
        try:
            _read(path, ended)
        except (OSError, ValueError, KeyError, SyntaxError, zipfile.BadZipFile, TactileLocError) as error:
            found.append(f"{path.relative_to(place.root)}: {type(error).__name__}: {error}")
    return found


def finished(place: Place) -> set[str]:
    """Return what is finished, each with what shows that it was not done again."""
    found = set()
    for entry in _entries(place):
        manifest = entry.path / MANIFEST
        if manifest.is_file():  # of one that is not complete yet, too: only its name is missing
            found.add(f"artifact {entry.stage}/{entry.digest} of {manifest.stat().st_mtime_ns}")
        else:
            found |= {f"piece {entry.stage}/{entry.digest}/{name}" for name in _pieces(entry.path)}
    for path in _files(place):
        if path.suffix in LINES:
            found |= {f"line {path.name} {number} {_digest(line)}" for number, line in enumerate(_lines(path))}
        elif path.parent.name == "rows" and not json.loads(path.read_text(encoding="utf-8"))["error"]:
            found.add(f"row {path.stem} of {path.stat().st_mtime_ns}")
    return found


def lost(before: set[str], after: set[str], place: Place) -> list[str]:
    """Return what was finished `before` and is not any more, though nothing that was made of it has taken its place."""
    artifacts = {word.split()[1] for word in after if word.startswith("artifact ")}

    def served(word: str) -> bool:
        kind, name, *_ = word.split()
        if kind == "piece":
            return name.rsplit("/", 1)[0] in artifacts
        return kind == "line" and name.endswith(".journal") and (place.work / name.removesuffix(".journal")).exists()

    return sorted(word for word in before - after if not served(word))


def leftovers(place: Place) -> list[str]:
    """Return what is there for no reason once a command has ended well, named without what is drawn by chance."""
    found = []
    for root in (place.work, place.store):
        for path in root.rglob("*"):
            if _is_left(path) and not any(map(_is_left, path.relative_to(root).parents)):
                found.append(path.name)
    if (place.store / JOURNALS).is_dir():
        found += [path.name for path in (place.store / JOURNALS).iterdir()]
    found += [path.name for path in place.temporary.iterdir() if path.name != "dask-scratch-space"]
    found += [f"dask {path.name}" for path in place.temporary.glob("dask-scratch-space/*") if path.is_dir()]
    return sorted(re.sub(r"[0-9a-f]{16,}", "HEX", name) for name in found)


def locks(place: Place) -> int:
    """Return how many files of locks there are."""
    return sum(1 for _ in place.store.glob("*/*.lock"))


def answer(place: Place) -> dict[str, str]:
    """Return a digest of each result, by its name, without what depends on the clock."""
    found = {}
    for entry in _entries(place):
        if entry.complete:
            records = read_artifact(entry.path).files.items()
            kept = sorted((name, one.sha256) for name, one in records if not CLOCKED.search(name.partition(".")[0]))
            found[f"{STAGE}{entry.stage}/{entry.digest}"] = _digest(json.dumps(kept))
    for path in _files(place):
        if path.suffix not in DRAWN and path.parent.name != "rows" and place.store not in path.parents:
            found[str(path.relative_to(place.work))] = _digest(_content(path))
    return found


def is_stage(name: str) -> bool:
    """Whether a result's name in `answer` is that of a stored stage, and no file's."""
    return name.startswith(STAGE)


def _is_left(path: Path) -> bool:
    """Whether by its name something is of use only while, or before, a command goes on."""
    return path.name.startswith(BESIDE) or path.suffix in (".partial", ".journal")


def _entries(place: Place) -> list[Entry]:
    return StageStore(place.store).entries()


def _damage(entry: Entry) -> str:
    """What is wrong with an artifact that is said to be complete; nothing, if its checksums hold."""
    if not entry.complete:
        return ""
    try:
        artifact = read_artifact(entry.path)
        artifact.read_signature()
        artifact.verify()
    except TactileLocError as error:
        return str(error)
    return ""


def _pieces(partial: Path) -> list[str]:
    """The pieces of an interrupted build that the next one takes."""
    try:
        known = json.loads((partial / ".pieces.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return []
    return [name for name, sums in known.items() if (partial / name).is_file() and hash_file(partial / name) in sums]


def _files(place: Place) -> Iterator[Path]:
    """The files in their place of the folder and of unfinished stages; those of finished ones have their checksums."""
    for root in (place.work, place.store):
        for path in sorted(root.rglob("*")):
            beside = any(part.startswith(BESIDE) for part in path.relative_to(root).parts)
            if path.is_file() and not beside and path.suffix != ".lock":
                yield path


def _lines(path: Path) -> list[bytes]:
    """The whole lines of a file."""
    return [line for line in path.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]


def _read(path: Path, ended: bool) -> None:
    """Read a file by what its name says. Raises ValueError and others where it is not whole."""
    if path.suffix == ".json":
        json.loads(path.read_text(encoding="utf-8"))
    elif path.suffix in LINES:
        for line in _lines(path):
            json.loads(line)
        if ended and not (b"\n" + path.read_bytes()).endswith(b"\n"):
            raise ValueError("ends in half a line")
    elif path.suffix == ".png":
        with Image.open(path) as picture:
            picture.load()
    elif path.suffix in (".npz", ".npy"):
        np.load(path, allow_pickle=False)
    elif path.suffix == ".mcap":
        if damage := Recording(path).read_contents().damage:
            raise ValueError(damage)
    elif path.suffix in (".csv", ".md", ".html") and not path.read_bytes().endswith(b"\n"):
        raise ValueError("ends in half a line")


def _content(path: Path) -> str:
    """What a result says, without what depends on the clock."""
    if path.suffix == ".json":
        return json.dumps(_timeless(json.loads(path.read_text(encoding="utf-8"))))
    if path.suffix == ".jsonl":  # to which each run adds; the last that was said of a frame counts
        records = [_timeless(json.loads(line)) for line in _lines(path)]
        return json.dumps({record["name"]: record for record in records})
    if path.suffix == ".csv":
        with path.open(newline="", encoding="utf-8") as file:
            return json.dumps(_timeless(list(csv.DictReader(file))))
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            return json.dumps(_timeless({name: _digest(file[name].tobytes()) for name in sorted(file)}))
    return path.read_bytes().hex()


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(item) for key, item in value.items() if not CLOCKED.search(key)}
    return [_timeless(item) for item in value] if isinstance(value, list) else value


def _digest(text: str | bytes) -> str:
    return hashlib.sha256(text if isinstance(text, bytes) else text.encode()).hexdigest()[:16]
