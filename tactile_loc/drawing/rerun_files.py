"""Results and replayed recordings as Rerun files (.rrd)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from tactile_loc.core.errors import TactileLocError
from tactile_loc.core.geometry.rigid import covariance_along, invert
from tactile_loc.core.slots.scene import Scene
from tactile_loc.drawing.rerun_log import Logged, RerunLog
from tactile_loc.locate.located_frame import LocatedFrame
from tactile_loc.locate.result import Localization
from tactile_loc.store.files import write_atomically
from tactile_loc.tasks.replay import FrameRecord, FrameView, Replay


def write_localization(path: Path, localization: Localization, scene: Scene) -> Path:
    """Write a result as a Rerun file, a frame a touch, atomically, and return the path; poses are in the first one's.

    Raises OutputError and MissingLibraryError.
    """

    def write(temporary: Path) -> None:
        first, located = localization.touch, LocatedFrame.of(localization)
        with RerunLog(temporary, scene) as log:
            log.add(Logged(0, 0.0, first.image, first, located, localization.posterior, first.name))
            for number, touch in enumerate(localization.others, 1):
                T_other_first = invert(np.asarray(touch.T_base_sensor)) @ np.asarray(first.T_base_sensor)
                seen = located.seen_from(T_other_first)
                log.add(Logged(number, float(number), touch.image, touch, seen, says=touch.name))

    return write_atomically(path, write)


def write_replay(path: Path, replay: Replay, records: Sequence[FrameRecord]) -> Path:
    """Write what the images of a recording came to as a Rerun file, atomically, and return the path.

    Images are read anew. Raises OutputError and MissingLibraryError.
    """

    def write(temporary: Path) -> None:
        with RerunLog(temporary, replay.localizer.scene) as log:
            for record, view in zip(records, replay.views(), strict=True):
                log.add(_convert_record(record, view, records[0].stamp_ns, replay))

    return write_atomically(path, write)


def _convert_record(record: FrameRecord, view: FrameView, start_ns: int, replay: Replay) -> Logged:
    touch = None
    with suppress(TactileLocError):  # the record says why there is none
        touch = replace(replay.touch(view.image), T_base_sensor=view.T_base_frame)
    time_s = 1e-9 * (record.stamp_ns - start_ns)
    return Logged(record.number, time_s, view.image, touch, _locate_in_sensor(record, view))


def _locate_in_sensor(record: FrameRecord, view: FrameView) -> LocatedFrame:
    """What a record says, in the sensor's frame."""
    if record.T_frame_object is None:
        return LocatedFrame(record.verdict, says=record.says)
    T = np.eye(4) if view.T_base_frame is None else invert(view.T_base_frame)
    covariance = None if record.covariance is None else covariance_along(np.array(record.covariance), T[:3, :3])
    shares, iou = np.array([record.probability or 0.0]), record.imprint_iou
    return LocatedFrame(
        record.verdict, (T @ record.T)[None], shares, covariance, np.nan if iou is None else iou, says=record.says
    )
