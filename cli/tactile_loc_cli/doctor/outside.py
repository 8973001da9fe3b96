"""Running trials in processes of their own, so that nothing that crashes or hangs there does so here."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from typing import Any

TIMEOUT_S = 90.0
LONGEST = 240  # characters of a reason that are shown


@dataclass(frozen=True)
class Outcome:
    """What came of a trial: its facts, or the reason why it failed."""

    facts: dict[str, Any] = field(default_factory=dict)
    failure: str = ""


def attempt(trial: str, *words: str, timeout_s: float = TIMEOUT_S) -> Outcome:
    """Run a trial of `trials.py`; whatever becomes of it, return."""
    # -P: a file of the folder we are in must not be taken for a library
    line = [sys.executable, "-P", "-m", "tactile_loc_cli.doctor.trials", trial, *words]
    try:
        done = subprocess.run(
            line, capture_output=True, text=True, errors="replace", timeout=timeout_s, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        return Outcome(failure=f"no answer within {timeout_s:g} s")
    except OSError as error:
        return Outcome(failure=f"Python cannot be started ({error.strerror})")
    if done.returncode < 0:
        return Outcome(failure=f"it crashes ({_signal(-done.returncode)})")
    if done.returncode > 0:
        return Outcome(failure=_last_line(done.stderr) or f"it ends with code {done.returncode}")
    try:
        return Outcome(facts=dict(json.loads(_last_line(done.stdout, len(done.stdout)))))
    except (ValueError, TypeError):
        return Outcome(failure="it says nothing")


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _last_line(text: str, longest: int = LONGEST) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:longest] if lines else ""
