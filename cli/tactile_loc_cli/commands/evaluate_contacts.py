"""`tactile-loc evaluate --contacts`: how well objects are located from several touches."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc_cli.console import say, say_table

if TYPE_CHECKING:
    from tactile_loc.evaluation.fusion_tables import FusionRun
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.io.config import RunConfig
    from tactile_loc.locate.localizer import Localizer

DEFAULT_COUNT = 100
OF_EACH_TOUCH = ("errors_m", "posterior_metrics")  # keys of the files whose lists are as long as there are touches

_PART = re.compile(r"(\d+)(?:\.\.(\d+))?")


def parse_contacts(text: str) -> tuple[int, ...]:
    """Return the numbers of contacts that a text such as "1..7" or "1,2,5..7" names, rising. Raises ConfigError."""
    from tactile_loc.core.errors import ConfigError
    from tactile_loc.evaluation.fusion import MOST_FUSED

    numbers: set[int] = set()
    for part in text.replace(" ", "").split(","):
        match = _PART.fullmatch(part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= first <= last <= MOST_FUSED:
            raise ConfigError(
                f"--contacts {text!r} names no numbers of contacts; write a range or a list from 1 to {MOST_FUSED}, "
                "such as 1..7 or 1,2,3"
            )
        numbers.update(range(first, last + 1))
    return tuple(sorted(numbers))


def evaluate_contacts(
    jobs: Sequence[tuple[RunConfig, Localizer]], contacts: Sequence[int], count: int, touches: SimulatedTouches,
    out: Path,
) -> dict[str, Any]:  # fmt: skip
    """Evaluate each localizer with each number of contacts, write tables and the picture to `out`, show the medians.

    Return the document that was written, without each example's errors, and the paths.
    """
    runs = [_run(settings, localizer, contacts, count, touches) for settings, localizer in jobs]
    examples = f"{count} simulated {'example' if count == 1 else 'examples'} ({touches.in_words()})"
    heading = f"Localisation from several contacts: {examples} for each object, seed {touches.seed}"
    return _report(runs, {"examples": count, **dataclasses.asdict(touches)}, heading, out)


def _run(
    settings: RunConfig, localizer: Localizer, contacts: Sequence[int], count: int, touches: SimulatedTouches
) -> FusionRun:
    from tactile_loc.evaluation.fusion import evaluate_fusion
    from tactile_loc.evaluation.fusion_tables import FusionRun
    from tactile_loc.locate.result_json import resolved

    evaluation = evaluate_fusion(localizer, contacts, count, touches)
    obj, poses = localizer.object, len(localizer.model.grid)
    return FusionRun(obj.name, str(obj.symmetry), settings.encoder.name, poses, evaluation, resolved(settings))


def _report(runs: Sequence[FusionRun], protocol: dict[str, object], heading: str, out: Path) -> dict[str, Any]:
    from tactile_loc.drawing.pictures import save_figure
    from tactile_loc.evaluation.figures import draw_fusion
    from tactile_loc.evaluation.fusion_tables import median_header, median_rows, record, write_fusion_tables

    written = write_fusion_tables(out, runs, protocol, heading)
    written.append(save_figure(out / "contacts.png", draw_fusion(runs, heading)))
    header = [head.split()[0] for head in median_header(runs)]
    say("median ADD by number of contacts, mm")
    say_table([header, *median_rows(runs, normalised=False)], left=3)
    say("\nmedian ADD as a share of a random pose's mean")
    say_table([header, *median_rows(runs, normalised=True)], left=3)
    for run in runs:
        _say_without_common(run)
    say(f"\nwritten: {', '.join(map(str, written))}")
    return summarised(record(runs, protocol), written)


def summarised(document: dict[str, Any], written: Sequence[Path]) -> dict[str, Any]:
    """Return an evaluation's document without the numbers of each touch, and with the paths that were written."""
    return {**_without_touches(document), "written": [str(path) for path in written]}


def _without_touches(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_touches(item) for key, item in value.items() if key not in OF_EACH_TOUCH}
    return [_without_touches(item) for item in value] if isinstance(value, list) else value


def _say_without_common(run: FusionRun) -> None:
    """Say how often no pose touched all sensors, if it happened."""
    found = run.evaluation
    counts = {n: found.without_common("best-1", n) for n in found.contacts}
    if any(counts.values()):
        listed = ", ".join(f"{count} with {n}" for n, count in counts.items() if count)
        say(
            f"\n{run.object}: examples without a pose that touches all sensors, located from the first contact alone: "
            f"{listed} contacts"
        )
