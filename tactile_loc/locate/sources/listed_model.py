"""Artifacts that are built once for an object and a sensor, and stored: grid, shapes, encoder, bank."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.runtime.progress import NOTE, Progress, rank
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.simulate.contact_poses import make_contact_grid, mark_contact
from tactile_loc.slots.encoder import Checkpoints, Encoder, TrainingProblem
from tactile_loc.slots.grid import GridSampler
from tactile_loc.store.artifact import Artifact
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace, WorkspaceCheckpoints

log = logging.getLogger(__name__)

SHARD = 1024  # poses that are rendered at once and saved in one file
NO_CONTACT = 65535
STAGE_VERSIONS = {"grid": 5, "shapes": 3, "encoder": 3, "bank": 3}


def make_grid_key(scene: Scene, sampler: GridSampler) -> StageKey:
    """Return the store key of the pose grid that `sampler` makes for `scene`."""
    return StageKey("grid", STAGE_VERSIONS["grid"], {
        "object": scene.object.describe(), "sampler": sampler.describe(), "sensor": scene.geometry.describe(),
    }, scene.object.name)  # fmt: skip


def make_shapes_key(grid: StageKey, scene: Scene) -> StageKey:
    """Return the store key of a grid's contact shapes, drawn as in `scene`."""
    return StageKey("shapes", STAGE_VERSIONS["shapes"], {
        "grid": grid.digest, "renderer": scene.renderer.describe(), "drawing": scene.drawing, "shard": SHARD,
    })  # fmt: skip


@dataclass(frozen=True, eq=False)
class ShapeBank:
    """The contact shapes of a grid's poses at full press, as 16-bit fractions of `max_depth_m`.

    Each file has the shapes of one shard of poses.
    """

    artifact: Artifact
    max_depth_m: float

    @property
    def kept(self) -> NDArray[np.int64]:
        """The indices (K,) of the contact grid's poses that make enough contact."""
        return self.artifact.load_array("kept")

    def shards(self, press_depth_m: float | None = None) -> Iterator[NDArray[np.float32]]:
        """Yield contact depths (S, H, W), S > 0, in metres, cut at `press_depth_m`, in the grid's order."""
        press = np.float32(self.max_depth_m if press_depth_m is None else press_depth_m)
        for number, size in enumerate(self.artifact.load_json("sizes")):
            if size:  # a shard is empty if none of its poses makes enough contact
                yield self._decode(self.artifact.load_array(_name_shard(number)), press)

    def shape(self, index: int, press_depth_m: float) -> NDArray[np.float32]:
        """Return the contact depth (H, W) in metres of one pose of the grid, cut at `press_depth_m`."""
        ends = np.cumsum(self.artifact.load_json("sizes"))
        number = int(np.searchsorted(ends, index, side="right"))
        start = int(ends[number - 1]) if number else 0
        code = self.artifact.load_array(_name_shard(number))[index - start]
        return self._decode(code, np.float32(press_depth_m))

    def _decode(self, codes: NDArray[np.uint16], press_depth_m: np.float32) -> NDArray[np.float32]:
        depths = codes * np.float32(self.max_depth_m / NO_CONTACT)
        return np.where(codes == NO_CONTACT, press_depth_m, np.minimum(depths, press_depth_m))


@dataclass(frozen=True, eq=False)
class ObjectPoseModel:
    """An object's pose grid and the contact shapes of the grid's poses."""

    grid: PoseGrid
    shapes: ShapeBank
    key: StageKey = field(repr=False)

    @cached_property
    def size(self) -> int:
        """Number of poses."""
        return len(self.grid)


def build_model(scene: Scene, sampler: GridSampler, store: StageStore, progress: Progress) -> ObjectPoseModel:
    """Build the grid of `sampler` and its contact shapes in `scene`, or load them from the store."""
    grid = make_grid_key(scene, sampler)
    artifact = store.build(grid, lambda work: _sample_grid(work, scene, sampler, progress))
    contact = PoseGrid(np.array(artifact.load_array("T_sensor_object")), PoseMetric(scene.object))
    key = make_shapes_key(grid, scene)
    percent = sampler.options.min_contact_percent
    rendered = store.build(key, lambda work: _render_all(work, contact, scene, percent, progress))
    shapes = ShapeBank(rendered, scene.geometry.max_depth_m)
    return ObjectPoseModel(PoseGrid(contact.T_sensor_object[shapes.kept], contact.metric), shapes, key)


def make_bank_key(shapes: StageKey, encoder: Encoder, press_depth_m: float, trained: str = "") -> StageKey:
    """Return the store key of the bank of contact shapes cut at `press_depth_m` metres.

    `trained` is the digest of the encoder's weights; empty for an encoder that needs no training.
    """
    return StageKey("bank", STAGE_VERSIONS["bank"], {
        "shapes": shapes.digest, "encoder": encoder.describe(), "trained": trained, "press_depth_m": press_depth_m,
    })  # fmt: skip


def build_bank(
    model: ObjectPoseModel, scene: Scene, encoder: Encoder, press_depth_m: float, store: StageStore,
    progress: Progress, trained: str = "",
) -> NDArray[np.float32]:  # fmt: skip
    """Return the bank (N, D) of the model's contact shapes cut at `press_depth_m` metres: stored, or built now.

    `trained` is as for `make_bank_key`.
    """
    pressed = scene.press(press_depth_m)

    def encode(work: Workspace) -> None:
        rows = []
        with progress.task("encoding contact shapes", model.size) as advance:
            for depths in _press_shapes(model, pressed):
                rows.append(encoder.encode(depths, press_depth_m, pressed.geometry))
                advance(len(depths))
        # rows of an encoder that needs no training are mostly zeros, so they are compressed
        work.save_array("bank", np.concatenate(rows), packed=not encoder.capabilities.needs_training)

    return np.asarray(store.build(make_bank_key(model.key, encoder, press_depth_m, trained), encode).load_array("bank"))


def _press_shapes(model: ObjectPoseModel, pressed: Scene) -> Iterator[NDArray[np.float32]]:
    """Yield the contact depths (S, H, W), S > 0, metres, of the grid's poses at the scene's press.

    If rays are parallel, or shapes are drawn as in the paper, the shapes at full press are cut at the lighter press. A
    pinhole camera sees a lighter press from farther away, so the shapes are rendered again.
    """
    press_m, deepest_m = pressed.geometry.indentation_m, model.shapes.max_depth_m
    if press_m == deepest_m or not pressed.geometry.is_pinhole or pressed.drawing == "paper":
        yield from model.shapes.shards(press_m)
        return
    poses = model.grid.raise_level(deepest_m - press_m).T_sensor_object
    for start in range(0, len(poses), SHARD):
        yield pressed.render_grid_depths(poses[start : start + SHARD])


def _sample_grid(work: Workspace, scene: Scene, sampler: GridSampler, progress: Progress) -> None:
    with progress.task("sampling the pose grid", 1) as advance:
        work.save_array("T_sensor_object", make_contact_grid(sampler, scene).T_sensor_object, packed=True)
        advance(1)


def _render_all(work: Workspace, grid: PoseGrid, scene: Scene, percent: float, progress: Progress) -> None:
    """Render the grid shard by shard; skip the shards that an interrupted build finished."""
    kept: list[NDArray[Any]] = []
    sizes = []
    with progress.task("rendering contact shapes", len(grid)) as advance:
        for number, start in enumerate(range(0, len(grid), SHARD)):
            poses = grid.T_sensor_object[start : start + SHARD]
            name = _name_shard(number)
            codes = work.load(name)
            enough = work.load(f"{name}-enough", keep=False)
            if codes is None or enough is None:
                depths = scene.render_grid_depths(poses)
                enough = mark_contact(depths, scene, percent)
                codes = _encode(depths[enough], scene.geometry.max_depth_m)
                work.save_array(name, codes, packed=True)
                work.save_array(f"{name}-enough", enough, keep=False)
            kept.append(start + np.flatnonzero(enough))
            sizes.append(len(codes))
            advance(len(poses))
    log.info("grid: %d poses, %d with enough contact", len(grid), sum(sizes))
    if not sum(sizes):
        raise GridError(
            f"no pose of {scene.object.name} touches {percent:g} % of the sensor; lower grid.min_contact_percent or "
            "choose another face"
        )
    work.save_array("kept", np.concatenate(kept))
    work.save_json("shards", len(sizes))
    work.save_json("sizes", sizes)


def _name_shard(number: int) -> str:
    return f"depth-{number:05d}"


def _encode(depths_m: NDArray[np.float32], max_depth_m: float) -> NDArray[np.uint16]:
    """Encode contact depths (S, H, W) as 16-bit fractions; a pixel in contact never rounds to no contact."""
    codes = np.rint(depths_m * np.float32(NO_CONTACT / max_depth_m))
    touching = depths_m < np.float32(max_depth_m)
    return np.where(touching, np.minimum(codes, NO_CONTACT - 1), NO_CONTACT).astype(np.uint16)


WEIGHTS = "encoder.safetensors"


def make_encoder_key(shapes: StageKey, encoder: Encoder, sampler: GridSampler) -> StageKey | None:
    """Return the store key of the weights that `encoder` learns from contact shapes.

    Returns None if the encoder needs no training.
    """
    if not encoder.capabilities.needs_training:
        return None
    return StageKey("encoder", STAGE_VERSIONS["encoder"], {
        "shapes": shapes.digest, "encoder": encoder.describe(), "sampler": sampler.describe(),
    })  # fmt: skip


def train_encoder(
    encoder: Encoder, key: StageKey | None, problem: Callable[[Checkpoints], TrainingProblem], store: StageStore,
    name: str = "",
) -> str:  # fmt: skip
    """Train `encoder` on a problem, or load the weights stored under `key`; return the weights' digest.

    If the encoder needs no training, `key` is None and the digest is empty. `name` is that of the object, for a
    message. If torchrun started several processes, they train together, and the first process stores the weights.
    Raises the errors of `Encoder.fit`.
    """
    if key is None:
        return ""

    def fit(work: Workspace) -> None:
        log.log(NOTE, "training the encoder%s; this takes minutes", f" of {name}" if name else "")
        encoder.fit(problem(WorkspaceCheckpoints(work)))
        work.save_file(WEIGHTS, encoder.save_weights)

    if rank() > 0 and store.get(key) is None:  # the first process holds the lock and waits for this one in `fit`
        encoder.fit(problem(Checkpoints()))
    else:
        encoder.load_weights(store.build(key, fit).find_file(WEIGHTS))
    return key.digest
