#!/usr/bin/env python3
"""Whether a track notices that the object has slipped, and how soon its pose is right again.

Slides are drawn as in track_starts.py; each track starts near the truth. At a random frame, the object slips along the
gel by 1 to 4 mm, or turns about the gel's middle by 3 to 15 degrees, unreported. The track goes on for AFTER_S seconds.

The touches show a slip if, over the first three frames after it, the pose before the slip has at least SHOWN less
imprint IoU than the true pose. *Flagged* counts slips that the tracker reports within three frames, of those that the
touches show. *False flags* are reports before the slip, and their number in 10,000 frames. *Right again* counts tracks
whose pose error is at most 1 mm at the end, and *sooner* those that are so at most GRACE frames after a batch estimate:
the key touches since the slip, located together at each frame. *Certain and wrong* is the share of frames after the
slip. Meshes are given as FILE[:UNITS] or a demo object's name. `--out` keeps the tracks, which are not measured again.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sequences import START_STD
from tactile_loc_benchmark.sliding_touches import Frame, Slip
from track_starts import (
    ELASTIC,
    ELASTIC_RATE_HZ,
    MM,
    RATE_HZ,
    RIGHT_MM,
    Drawn,
    collect,
    locate_by_keys,
    make_parser,
    make_seed,
    make_sliding,
    measure_off_mm,
    print_table,
    soften,
)

from tactile_loc.core.geometry.lie import move
from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.locate.localizer import Localizer
from tactile_loc.tracking.tracker import Tracker

SHOWN, IN_TIME, GRACE = 0.1, 3, 10
MOST_DRAWS = 20  # slides until one has a slip that stays on the gel
BEFORE_S, AFTER_S = (0.4, 1.2), 1.0  # seconds before and after the slip
SLIP_MM, TURN_DEG = (1.0, 4.0), (3.0, 15.0)


@dataclass(frozen=True)
class Track(Drawn):
    """A track through a slip. `shown` is the imprint IoU that the touches show; frames are numbered from the slip.

    `flags` are the frames with a report. `right_from` and `batch_from` are the frames from which the tracker's and the
    batch's pose are right at once; -1 if never. `wrong` counts frames that are certain and wrong, of `frames`.
    """

    slip_mm: float
    turn_deg: float
    shown: float
    before: int
    flags: list[int]
    right_from: int
    batch_from: int
    ends_right: bool
    wrong: int
    frames: int


def draw_slip(localizer: Localizer, condition: str, rng: np.random.Generator) -> tuple[list[Frame], Slip, int]:
    """Return the frames of a slide with a slip, the slip, and the number of its frame."""
    turn = rng.random() < 0.5
    slip = Slip(0.0, np.radians(rng.uniform(*TURN_DEG))) if turn else Slip(rng.uniform(*SLIP_MM) / MM, 0.0)
    rate_hz = ELASTIC_RATE_HZ if condition == ELASTIC else RATE_HZ
    at = round(rate_hz * rng.uniform(*BEFORE_S))
    source, sliding = make_sliding(localizer, condition)
    frames = sliding.draw_example(at + round(AFTER_S * rate_hz), rng, at, slip)
    return [soften(f, source, localizer, rng) for f in frames] if condition == ELASTIC else frames, slip, at


def explain(localizer: Localizer, T_base_object: np.ndarray, frames: Sequence[Frame]) -> float:
    """Return the mean imprint IoU of a pose (4, 4), metres, with the touches of frames; 0 without touches."""
    ious = [
        localizer.scene.match_touch(f.touch).imprint_ious((invert(f.T_base_sensor) @ T_base_object)[None], f.touch)
        for f in frames
        if f.touch is not None
    ]
    return float(np.mean(ious)) if ious else 0.0


def find_batch(localizer: Localizer, frames: Sequence[Frame]) -> int:
    """Return the first frame at which the key touches of the frames so far are located right; -1 if there is none."""
    located = enumerate(locate_by_keys(localizer, [[frame.touch] for frame in frames]))
    return next((number for number, (off_mm, *_) in located if off_mm <= RIGHT_MM), -1)


def track(localizer: Localizer, condition: str, number: int, seed: int) -> Track:
    """Return one track through a slip."""
    for attempt in range(MOST_DRAWS):
        rng = np.random.default_rng([*make_seed(localizer, condition, number, seed), attempt])
        try:
            frames, slip, at = draw_slip(localizer, condition, rng)
            break
        except TouchError:  # the slip leaves the gel
            continue
    else:
        raise SystemExit(f"hardly any slip of {localizer.object.name} stays on the gel")
    old, new = (frames[k].T_base_sensor @ frames[k].T_sensor_object for k in (at - 1, at))
    tracker = Tracker(localizer)
    first = frames[0].T_base_sensor @ frames[0].T_sensor_object
    tracker.start(move(first, START_STD * rng.normal(size=6)), np.diag(START_STD**2))
    found = [tracker.update(f.time_s, f.touch, f.T_base_sensor) for f in frames]
    soon, after = frames[at : at + IN_TIME], frames[at:]
    off_mm = [measure_off_mm(localizer, one.T_sensor_object, f) for one, f in zip(found[at:], after, strict=True)]
    right = np.array(off_mm) <= RIGHT_MM
    certain = np.array([one.verdict == "certain" for one in found[at:]])
    return Track(
        localizer.object.name, condition, number, MM * slip.shift_m, float(np.degrees(slip.turn_rad)),
        explain(localizer, new, soon) - explain(localizer, old, soon), at,
        [k - at for k, one in enumerate(found) if one.slipped], int(right.argmax()) if right.any() else -1,
        find_batch(localizer, after), bool(right[-1]), int((certain & ~right).sum()), len(after),
    )  # fmt: skip


def write_row(name: str, tracks: Sequence[Track]) -> str:
    """Return one row of the table."""
    shown = [one for one in tracks if one.shown >= SHOWN]
    flagged = sum(any(0 <= flag < IN_TIME for flag in one.flags) for one in shown)
    false, before = sum(sum(flag < 0 for flag in one.flags) for one in tracks), sum(one.before for one in tracks)
    known = [one for one in tracks if one.batch_from >= 0]
    sooner = sum(0 <= one.right_from <= one.batch_from + GRACE for one in known)
    wrong = sum(one.wrong for one in tracks) / sum(one.frames for one in tracks)
    return (
        f"| {name} | {len(tracks)} | {flagged} of {len(shown)} | {false} in {before}: {1e4 * false / before:.0f} | "
        f"{sum(one.ends_right for one in tracks)} | {sooner} of {len(known)} | {wrong:.1%} |"
    )


HEAD = (
    "| slips | number | flagged, of those shown | false flags, in 10,000 frames | right at the end | right at most "
    "10 frames after the batch estimate | certain and wrong |\n" + "|---" * 7 + "|"
)


def main() -> None:
    """Print the table."""
    print_table(HEAD, write_row, collect(make_parser(__doc__, "slips", 4, 8).parse_args(), Track, track))


if __name__ == "__main__":
    main()
