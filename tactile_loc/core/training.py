"""The stage in which an encoder learns: once for an object, a sensor and a grid, and read from the store after."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tactile_loc.core.hashing import StageKey
from tactile_loc.core.interfaces import Checkpoints, Encoder, GridSampler, TrainingProblem
from tactile_loc.core.model import ObjectPoseModel
from tactile_loc.core.progress import Progress, rank
from tactile_loc.core.scene import Scene
from tactile_loc.core.store import StageStore
from tactile_loc.core.workspace import Workspace

STAGE_VERSION = 2
CHECKPOINT, WEIGHTS = "checkpoint.safetensors", "encoder.safetensors"


class WorkspaceCheckpoints(Checkpoints):
    """Keeps a training's state in the folder where its stage is being built, until the stage is finished."""

    def __init__(self, work: Workspace) -> None:
        self._work = work

    def load(self) -> Path | None:
        """Return the checkpoint that an interrupted build left, if it is intact."""
        return self._work.load_file(CHECKPOINT, keep=False)

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the checkpoint atomically."""
        self._work.save_file(CHECKPOINT, write, keep=False)


def train_encoder(
    encoder: Encoder, model: ObjectPoseModel, scene: Scene, sampler: GridSampler, store: StageStore,
    progress: Progress,
) -> str:  # fmt: skip
    """Train `encoder` on the model's object, or load what was trained before; return what identifies the result.

    Encoders that need no training are left alone and identified by their description. Of several processes that
    torchrun started, the first stores what all of them train together. Raises what `fit` raises.
    """
    if not encoder.capabilities.needs_training:
        return ""
    key = StageKey("encoder", STAGE_VERSION, {
        "shapes": model.key.digest, "encoder": encoder.describe(), "sampler": sampler.describe(),
    })  # fmt: skip

    def fit(work: Workspace) -> None:
        checkpoints = WorkspaceCheckpoints(work)
        encoder.fit(TrainingProblem(model.grid, scene, sampler, model.shapes.shards, progress, checkpoints))
        work.save_file(WEIGHTS, encoder.save_weights)

    if rank() > 0 and store.get(key) is None:  # the first process holds the lock, and waits for this one in `fit`
        encoder.fit(TrainingProblem(model.grid, scene, sampler, model.shapes.shards, progress))
    else:
        encoder.load_weights(store.build(key, fit).file(WEIGHTS))
    return key.digest
