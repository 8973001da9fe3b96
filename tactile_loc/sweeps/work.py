"""One combination evaluated: the same function for a local process and for a worker of a cluster."""

from __future__ import annotations

import threading
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.core.errors import ConfigError, TactileLocError
from tactile_loc.core.objects import ObjectModel
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.store import StageStore
from tactile_loc.sweeps.builds import BuildJournal
from tactile_loc.sweeps.combinations import combination_key, describe_components

# OpenGL contexts and numba's simplest threads belong to one thread at a time, and a Dask worker may have several.
_ALONE = threading.Lock()

JOURNALS = "sweep-builds"  # a folder of the store


@dataclass(frozen=True)
class Job:
    """A combination as a worker gets it; `store` is the folder of the stage store, the same for all workers."""

    key: str
    config: RunConfig
    count: int
    store: Path


@dataclass(frozen=True)
class Outcome:
    """What became of a job: `measured`, or an `error` (one sentence) and, if it was not raised on purpose, its `trace`.

    `built` names the stages, "stage digest", that were built for it, by processes that were killed at it as well.
    """

    key: str
    measured: dict[str, Any] | None
    built: tuple[str, ...] = ()
    error: str = ""
    trace: str = ""


def work(job: Job, obj: ObjectModel) -> Outcome:
    """Evaluate a combination on its object; whatever goes wrong is in the outcome."""
    with _ALONE:
        store = StageStore(job.store)
        store.built = built = BuildJournal(job.store / JOURNALS / f"{job.key}.txt")
        measured, error, trace = None, "", ""
        try:
            measured = _measured(job, obj, store)
        except TactileLocError as raised:
            error = str(raised)
        except Exception as raised:  # noqa: BLE001 - a stranger's component may raise anything
            error, trace = f"{type(raised).__name__}: {raised}", traceback.format_exc()
        return Outcome(job.key, measured, built.finish(), " ".join(error.split()), trace)


def _measured(job: Job, obj: ObjectModel, store: StageStore) -> dict[str, Any]:
    from tactile_loc.evaluation.protocol import evaluate
    from tactile_loc.evaluation.simulated_touches import SimulatedTouches
    from tactile_loc.sweeps.measures import measures

    config = job.config
    if combination_key(config, obj, job.count, describe_components(config)) != job.key:
        raise ConfigError(
            "the worker's tactile-loc, its plugins or its sensor file are others than where the sweep was started; "
            "install the same versions there"
        )
    localizer = Localizer(config, obj, store)
    start_s = time.perf_counter()
    localizer.describe_scores()  # the grid, its shapes, and a trained encoder
    _ = localizer.temperature_scaling
    model_s = time.perf_counter() - start_s if store.built else 0.0
    evaluation = evaluate(localizer, job.count, SimulatedTouches(config.touch.noise, config.seed, images=False))
    return {**measures(evaluation, localizer.model.size), "model_s": round(model_s, 3)}
