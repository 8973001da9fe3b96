"""What a command leaves: what is broken, what is finished, what should not be there, and what the answer is."""

from __future__ import annotations

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

from killing.commands import Place
from tactile_loc.core.errors import TactileLocError
from tactile_loc.io.streams.recordings import Recording
from tactile_loc.store.artifact import MANIFEST, read_artifact
from tactile_loc.store.keys import hash_file
from tactile_loc.store.store import Entry, StageStore

STAGE = "store: "  # before the names of stages in an answer
BESIDE = ".tmp-"  # before the names of files that are written beside their place
LINES = (".jsonl", ".journal")
UNREADABLE = (OSError, ValueError, LookupError, EOFError, SyntaxError, zipfile.BadZipFile, zlib.error, TactileLocError)
CLOCKED = re.compile(
    r"result_sha256|seconds|created|versions|duration|time_s|^built$|_ms$|^time_|_s$|distributions|^(key|source|path)$"
)  # what depends on the clock, on how often a command was begun, or on the folder it was begun in
DRAWN = (".png", ".html", ".md", ".parquet", ".log", ".toml")  # pictures and pages, and the contents of rows again


def broken(place: Place, ended: bool) -> list[str]:
    """Return what cannot be read. Of a command that `ended`, half lines are broken, too."""
    found = [
        f"artifact {entry.stage}: {error}" for entry in StageStore(place.store).entries() if (error := _damage(entry))
    ]
    for path in _files(place):
        try:
            _content(path, ended)
        except UNREADABLE as error:
            found.append(f"{path.relative_to(place.root)}: {type(error).__name__}: {error}")
    return found


def finished(place: Place) -> set[str]:
    """Return what is finished, each with what would change if it was done again."""
    found = set()
    for entry in StageStore(place.store).entries():
        manifest = entry.path / MANIFEST
        if manifest.is_file():  # even of an artifact that lacks only its name
            found.add(f"artifact {entry.stage}/{entry.digest} of {manifest.stat().st_mtime_ns}")
        elif (entry.path / ".pieces.json").is_file():  # of which the next build takes those that are whole
            for name, sums in json.loads((entry.path / ".pieces.json").read_text(encoding="utf-8")).items():
                if (entry.path / name).is_file() and hash_file(entry.path / name) in sums:
                    found.add(f"piece {entry.stage}/{entry.digest}/{name}")
    for path in _files(place):
        if path.suffix in LINES:
            found |= {f"line {path.name} {number} {_digest(line)}" for number, line in enumerate(_lines(path))}
        elif path.parent.name == "rows" and not json.loads(path.read_text(encoding="utf-8"))["error"]:
            found.add(f"row {path.stem} of {path.stat().st_mtime_ns}")
    return found


def lost(before: set[str], after: set[str], place: Place) -> list[str]:
    """Return what was finished `before` and is gone, unless something that was made of it has taken its place."""
    artifacts = {word.split()[1] for word in after if word.startswith("artifact ")}

    def served(word: str) -> bool:
        kind, name, *_ = word.split()
        if kind == "piece":
            return name.rsplit("/", 1)[0] in artifacts
        return kind == "line" and name.endswith(".journal") and (place.work / name.removesuffix(".journal")).exists()

    return sorted(word for word in before - after if not served(word))


def leftovers(place: Place) -> list[str]:
    """Return what is there for no reason after a command has ended well, without the random parts of names."""
    found = []
    for root in (place.work, place.store):
        left = [path.relative_to(root) for path in root.rglob("*") if _is_left(path)]
        found += [path.name for path in left if not any(map(_is_left, path.parents))]
    found += [path.name for path in place.store.glob("sweep-builds/*")]
    found += [path.name for path in place.temporary.iterdir() if path.name != "dask-scratch-space"]
    found += [f"dask {path.name}" for path in place.temporary.glob("dask-scratch-space/*") if path.is_dir()]
    return sorted(re.sub(r"[0-9a-f]{16,}", "HEX", name) for name in found)


def locks(place: Place) -> int:
    """Return how many lock files there are."""
    return len(list(place.store.glob("*/*.lock")))


def answer(place: Place) -> dict[str, str]:
    """Return a digest of each result by its name, without what depends on the clock."""
    found = {}
    for entry in StageStore(place.store).entries():
        if entry.complete:
            records = read_artifact(entry.path).files.items()
            kept = sorted((name, one.sha256) for name, one in records if not CLOCKED.search(name.partition(".")[0]))
            found[f"{STAGE}{entry.stage}/{entry.digest}"] = _digest(json.dumps(kept))
    for path in _files(place):
        if path.suffix not in DRAWN and path.parent.name != "rows" and place.store not in path.parents:
            found[str(path.relative_to(place.work))] = _digest(_content(path))
    return found


def _is_left(path: Path) -> bool:
    """Whether the name says that it serves only a command that goes on."""
    return path.name.startswith(BESIDE) or path.suffix in (".partial", ".journal")


def _damage(entry: Entry) -> str:
    """Return what is wrong with an artifact that counts as complete."""
    try:
        if entry.complete:
            artifact = read_artifact(entry.path)
            artifact.read_signature()
            artifact.verify()
    except TactileLocError as error:
        return str(error)
    return ""


def _files(place: Place) -> Iterator[Path]:
    """Yield the files in their place: of the folder and of the store."""
    for root in (place.work, place.store):
        for path in sorted(root.rglob("*")):
            beside = any(part.startswith(BESIDE) for part in path.relative_to(root).parts)
            if path.is_file() and not beside and path.suffix != ".lock":
                yield path


def _lines(path: Path) -> list[bytes]:
    """Return the whole lines of a file."""
    return [line for line in path.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]


def _content(path: Path, ended: bool = True) -> str:
    """Return what a file says, without what depends on the clock. Raises ValueError and others if it is not whole."""
    text = path.read_bytes()
    if path.suffix in (".csv", ".md", ".html", *(LINES if ended else ())) and not (b"\n" + text).endswith(b"\n"):
        raise ValueError("ends in half a line")
    if path.suffix == ".json":
        return json.dumps(_timeless(json.loads(text)))
    if path.suffix in LINES:  # each run appends to .jsonl; the last line of a frame counts
        records = [_timeless(json.loads(line)) for line in _lines(path)]
        return json.dumps({record["name"]: record for record in records} if path.suffix == ".jsonl" else records)
    if path.suffix == ".csv":
        return json.dumps(_timeless(list(csv.DictReader(text.decode().splitlines()))))
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            return json.dumps(_timeless({name: _digest(file[name].tobytes()) for name in sorted(file)}))
    if path.suffix == ".npy":
        np.load(path, allow_pickle=False)
    elif path.suffix == ".png":
        Image.open(path).load()
    elif path.suffix == ".mcap" and (damage := Recording(path).read_contents().damage):
        raise ValueError(damage)
    return text.hex()


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(item) for key, item in value.items() if not CLOCKED.search(key)}
    return [_timeless(item) for item in value] if isinstance(value, list) else value


def _digest(text: str | bytes) -> str:
    return hashlib.sha256(text if isinstance(text, bytes) else text.encode()).hexdigest()[:16]
