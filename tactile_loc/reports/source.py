"""Which result a path names: that of a run, of an evaluation, of several contacts, or of a sweep."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.core.errors import TactileLocError

KINDS = {"result": "run", "results": "evaluation", "contacts": "contacts", "sweep": "sweep"}
SUFFIXES = (".json", ".npz", ".csv", ".md", ".png")


class ResultError(TactileLocError):
    """A result cannot be shown: no such file, damaged, or written by another version."""


@dataclass(frozen=True)
class Source:
    """A result on disk: its kind, one of KINDS' values, and its JSON file."""

    kind: str
    path: Path

    @property
    def folder(self) -> Path:
        """The folder that holds the result."""
        return self.path.parent

    def document(self) -> dict[str, Any]:
        """Return the JSON document. Raises ResultError when it is none."""
        try:
            found = json.loads(self.path.read_bytes())
        except OSError as error:
            raise ResultError(f"{self.path} cannot be read ({error.strerror or error})") from error
        except ValueError as error:
            raise ResultError(f"{self.path} is damaged: it is no JSON ({error}); make the result again") from error
        if not isinstance(found, dict):
            raise ResultError(f"{self.path} is no result: it holds a {type(found).__name__}, not a table of keys")
        return found


def find_source(path: Path) -> Source:
    """Return the result that a path names: its folder, or one of its files. Raises ResultError if it names none."""
    if path.is_dir():
        return _in_folder(path)
    kind = KINDS.get(path.stem) if path.suffix in SUFFIXES else None
    if kind is None:
        what = "is no result" if path.exists() else "does not exist"
        raise ResultError(f"{path} {what}; give the folder that run, evaluate or sweep wrote, or its {_names()}")
    document = path.with_suffix(".json")
    if not document.is_file():
        raise ResultError(f"there is no {document}; give the folder that run, evaluate or sweep wrote")
    return Source(kind, document)


def _in_folder(folder: Path) -> Source:
    found = [Source(kind, folder / f"{name}.json") for name, kind in KINDS.items()]
    found = [source for source in found if source.path.is_file()]
    if not found:
        hint = ""
        if (folder / "results.csv").is_file():
            hint = "; of a folder of touches, give the folder of one"
        raise ResultError(f"{folder} holds no result: none of {_names()}{hint}")
    if len(found) > 1:
        names = " and ".join(source.path.name for source in found)
        raise ResultError(f"{folder} holds several results, {names}; give one of these files")
    return found[0]


def _names() -> str:
    return ", ".join(f"{name}.json" for name in KINDS)
