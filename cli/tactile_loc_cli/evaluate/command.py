"""`tactile-loc evaluate`: measure what `run` answers, or follow the paper's protocol."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.evaluate.jobs import Asked
from tactile_loc_cli.options import RunOptions, declare

DEFAULT_OUT = Path("evaluation")

_PART = re.compile(r"(\d+)(?:\.\.(\d+))?")

Objects = Annotated[
    list[str] | None,
    declare("--object FILE|DEMO", "Mesh file or demo object; may be repeated. Default: all demo objects."),
]
Encoders = Annotated[list[str] | None, declare("--encoder NAME", "Encoder; may be repeated. Default: pixel.")]
Count = Annotated[
    int | None,
    declare(
        "--count N",
        "Number of simulated examples for each object, noise and seed. Default: 20. With --paper: 100, or 150 single "
        "touches.",
        min=1,
        max=100_000,
    ),
]
Together = Annotated[
    str | None,
    declare(
        "--together RANGE",
        "Locate from these numbers of touches together: 1..7, or 1,2,3 (at most 20). Default: 1..3; of your own "
        "touches, all. With --paper: single touches.",
    ),
]
OwnTouches = Annotated[
    list[Path] | None,
    declare(
        "--touches FILE|FOLDER",
        "Your own touches with known poses: a CSV table, the folder that `simulate` wrote, or a list of touches "
        "(.toml); may be repeated. Default: simulated touches.",
    ),
]
Images = Annotated[
    bool, declare("--images", "Simulate images of the touches, for a sensor that was calibrated on simulated images.")
]
Noises = Annotated[
    list[options.Noise] | None,
    declare("--noise <none|mild|strong>", "Noise of simulated touches; may be repeated. Default: none and strong."),
]
Paper = Annotated[bool, declare("--paper", "Follow the protocol of the paper, on a grid that lists its poses.")]
Seeds = Annotated[
    list[int] | None, declare("--seed N", "Seed of the simulated touches; may be repeated. Default: 0.", min=0)
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of the results and pictures.")]
COMPARED = ("grid", "renderer", "matcher", "refiner", "fuser")
Given = Annotated[
    RunOptions,
    options.Takes(
        "units",
        "symmetry",
        *options.TOUCH_FILES,
        "sensor",
        "zero",
        *COMPARED,
        *options.SETTINGS,
        "top",
        grid="Poses to search. Default: whole. With --paper: face.",
    ),
]


def evaluate(
    object: Objects = None,
    *,
    given: Given,
    touches: OwnTouches = None,
    count: Count = None,
    together: Together = None,
    noise: Noises = None,
    seed: Seeds = None,
    images: Images = False,
    paper: Paper = False,
    encoder: Encoders = None,
    out: Out = DEFAULT_OUT,
    store: options.Store = None,
) -> dict[str, Any]:
    """Measure how often `run` is right.

    Each object is located from 1 to N touches with known poses, simulated or your own. Errors are surface distances.
    The results are recall, verdicts and times (docs/evaluation.md). With several encoders, an option goes to the
    encoders that have it. After an interruption, the same command resumes.
    """
    from tactile_loc_cli.evaluate.paper import evaluate_paper
    from tactile_loc_cli.evaluate.recall import evaluate_answers

    numbers = None if together is None else parse_together(together)
    noises, seeds = tuple(dict.fromkeys(noise or ())), tuple(dict.fromkeys(seed or (0,)))
    asked = Asked(object, encoder, count, numbers, tuple(touches or ()), images, noises, seeds, out, store)
    if asked.touches:
        _require_no_simulation(asked, seed is not None, paper)
    require_writable(out)
    return evaluate_paper(given, asked) if paper else evaluate_answers(given, asked)


def _require_no_simulation(asked: Asked, seeded: bool, paper: bool) -> None:
    """Raise ConfigError if an option for simulated touches is given with touches from files."""
    simulated = {"--noise": asked.noises, "--count": asked.count, "--seed": seeded, "--images": asked.images}
    for flag, given in {**simulated, "--paper": paper}.items():
        if given:
            raise ConfigError(
                f"{flag} needs simulated touches; leave it out, or leave out --touches {asked.touches[0]}"
            )


def parse_together(text: str) -> tuple[int, ...]:
    """Return the numbers of touches in a text such as "1..7" or "1,2,5..7", in ascending order.

    Raises ConfigError if the text cannot be read.
    """
    from tactile_loc.evaluation.fusion import MOST_FUSED

    numbers: set[int] = set()
    for part in text.replace(" ", "").split(","):
        match = _PART.fullmatch(part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= first <= last <= MOST_FUSED:
            raise ConfigError(
                f"--together cannot be {text!r}; give a range or a list of numbers from 1 to {MOST_FUSED}, "
                "such as 1..7 or 1,2,3"
            )
        numbers.update(range(first, last + 1))
    return tuple(sorted(numbers))
