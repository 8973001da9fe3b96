"""Several processes at once on one store, of which some may be killed."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from killing.commands import Command, Done, Place, begin, ended
from killing.kills import Undisturbed, draw_of, judge_end
from killing.moments import end_group
from killing.record import Trials

PROCESSES = 8
KILLED = 3  # of them
BEGINS = re.compile(r"Stage (\S+ \S+) is being built\.")


def at_once(one: Command, wanted: int, trials: Trials, folder: Path, inputs: Path, calm: Undisturbed) -> Iterator[None]:
    """Run a command several times at once: undisturbed, with some of them killed, and all into one folder."""
    for kind in ("undisturbed", "some killed", "one folder"):
        name = f"done, {kind}"
        while trials.counts[name] < wanted:
            draw = draw_of(trials)
            places = _places(folder, inputs, shared=kind == "one folder")
            processes = [begin(place, [*one.words, "-v"]) for place in places]
            survivors = _killed_some(processes, draw, calm) if kind == "some killed" else range(PROCESSES)
            done = {k: ended(places[k], processes[k]) for k in survivors}
            for k, came in done.items():
                judge_end(came, places[k], calm, trials)
            if kind != "some killed":
                _built_once(list(done.values()), trials)
            trials.count(name)
            yield


def _places(folder: Path, inputs: Path, shared: bool) -> list[Place]:
    """Places of one store; `shared`: of one folder as well, each with outputs of its own."""
    store = folder / "store"
    places = [Place(folder / f"{0 if shared else k}", store, folder / f"said-{k}") for k in range(PROCESSES)]
    for place in places:
        (place.said or place.root).mkdir(parents=True, exist_ok=True)
        place.root.mkdir(parents=True, exist_ok=True)
        place.make(inputs)
    return places


def _killed_some(processes: Sequence[subprocess.Popen[str]], draw: np.random.Generator, calm: Undisturbed) -> list[int]:
    """Kill some, one after the other, at random moments; return which are left."""
    order = [int(k) for k in draw.permutation(PROCESSES)]
    for k in order[:KILLED]:
        with suppress(subprocess.TimeoutExpired):
            processes[k].wait(timeout=float(draw.uniform(0, calm.cold.whole_s)))
        end_group(processes[k])
    return order[KILLED:]


def _built_once(done: list[Done], trials: Trials) -> None:
    """No stage may be built by two processes."""
    begun = Counter(stage for one in done for stage in BEGINS.findall(one.err))
    trials.expect(bool(begun), "nobody built anything")
    twice = [stage for stage, count in begun.items() if count > 1]
    trials.expect(not twice, f"built more than once: {', '.join(twice)}")
