"""`tactile-loc evaluate`: measure what `run` answers."""

from typing import Annotated, Any

from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.evaluate.jobs import COMPARED, Asked
from tactile_loc_cli.options import RunOptions

Given = Annotated[
    RunOptions,
    options.Takes("units", "symmetry", *options.TOUCH_FILES, "sensor", "zero", *COMPARED, *options.SETTINGS, "top"),
]


def evaluate(*, given: Given, asked: Asked) -> dict[str, Any]:
    """Measure how often `run` is right.

    Each object is located from 1 to N touches with known poses, simulated or your own. Errors are pose errors.
    The results are recall, verdicts and times (docs/evaluation.md). With several encoders, an option goes to the
    encoders that have it. After an interruption, the same command resumes.
    """
    from tactile_loc_cli.evaluate.recall import evaluate_answers

    require_writable(asked.out)
    return evaluate_answers(given, asked)
