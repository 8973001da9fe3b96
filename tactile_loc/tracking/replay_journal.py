"""The journal of a replay: one line per finished frame, so that the same command resumes an interrupted replay."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from tactile_loc.store.files import parse_json
from tactile_loc.store.keys import StageKey
from tactile_loc.store.line_files import add_line, open_locked
from tactile_loc.tracking.replay import ReplayedFrame, ReplaySource

VERSION = 2  # increase it when replays give other results


class Journal:
    """The finished frames of a replay, `records`, in order, kept in an open file.

    An incomplete last line, from a process that was killed, is dropped. `stale` is true if the file belonged to another
    replay.
    """

    def __init__(self, file: IO[bytes], key: str) -> None:
        self._file = file
        lines = file.read().splitlines(keepends=True)
        head = json.dumps({"replay": key})
        self.stale = bool(lines) and lines[0] != head.encode() + b"\n"
        self.records = [] if self.stale else list(_keep_whole(lines[1:]))
        file.truncate(0 if self.stale else sum(map(len, lines[: 1 + len(self.records)])))
        if self.stale or not lines:
            add_line(file, head)

    def append(self, record: ReplayedFrame) -> None:
        """Append a finished frame, which then survives if the process is killed. Raises OutputError."""
        add_line(self._file, json.dumps(record.to_json()))
        self.records.append(record)


@contextmanager
def open_journal(path: Path, source: ReplaySource) -> Iterator[Journal]:
    """Open and lock the journal of a replay; delete it at the end if no frame has a pose.

    Raises OutputError if the journal cannot be written, or if another process uses it.
    """
    with open_locked(path) as file:
        file.seek(0)
        kept = Journal(file, make_replay_key(source))
        try:
            yield kept
        finally:
            if not any(record.T_frame_object is not None for record in kept.records):
                try:
                    path.unlink()
                except PermissionError:  # Windows deletes no open file
                    file.truncate(0)


def make_replay_key(source: ReplaySource) -> str:
    """Return a digest of all inputs of the frames' results: the images and the settings."""
    localizer = source.localizer
    return StageKey(
        "replay",
        VERSION,
        {
            **source.describe(),
            "object": localizer.object.describe(),
            "components": localizer.describe_components(),
            "configuration": localizer.config.resolve(),
        },
    ).digest


def _keep_whole(lines: list[bytes]) -> Iterator[ReplayedFrame]:
    for number, line in enumerate(lines):
        try:
            record = ReplayedFrame.of_json(parse_json(line))
        except ValueError:
            return
        if not line.endswith(b"\n") or record.number != number:
            return
        yield record
