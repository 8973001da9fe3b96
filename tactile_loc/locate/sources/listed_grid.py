"""The listed grid: a source of poses whose contact shapes are rendered and encoded once, and stored.

The stored artifacts are the grid, the contact shapes, the weights of a trained encoder, and the banks.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.exact_matcher import ExactMatcher
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.runtime.progress import NOTE, Progress, StageTimes
from tactile_loc.core.sensing.scene import DepthRenderer, Scene, View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import propose_together, split_modes
from tactile_loc.locate.probability import temperature
from tactile_loc.locate.probability.temperature import TemperatureScaling
from tactile_loc.locate.sources.scoring import GridScores, Scores
from tactile_loc.locate.sources.source import STAGE_VERSIONS, PoseSource, Posteriors, Values
from tactile_loc.simulate.contact_poses import make_contact_grid, mark_contact
from tactile_loc.simulate.listed_training import ListedProblem
from tactile_loc.simulate.touch_simulation import simulate_touches
from tactile_loc.slots.encoder import Checkpoints, Encoder, TrainingProblem
from tactile_loc.slots.grid import GridSampler
from tactile_loc.slots.matcher import Matcher
from tactile_loc.store.artifact import Artifact
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace, WorkspaceCheckpoints

log = logging.getLogger(__name__)

MOST_MEASURED = 2000  # poses whose distance to the nearest other pose is measured
SHARD = 1024  # poses that are rendered at once and saved in one file
NO_CONTACT = 65535


def make_grid_key(scene: Scene, sampler: GridSampler) -> StageKey:
    """Return the store key of the pose grid that `sampler` makes for `scene`."""
    inputs: dict[str, Any] = {
        "object": scene.object.describe(),
        "sampler": sampler.describe(),
        "sensor": scene.geometry.describe(),
    }
    return StageKey("grid", STAGE_VERSIONS["grid"], inputs, scene.object.name)


def make_shapes_key(grid: StageKey, scene: Scene, judge: DepthRenderer) -> StageKey:
    """Return the store key of a grid's contact shapes, drawn as in `scene`, at the poses that `judge` keeps."""
    drawn: dict[str, Any] = {"renderer": scene.renderer.describe(), "shard": SHARD}
    if judge.describe() != drawn["renderer"]:
        drawn["judge"] = judge.describe()
    return StageKey("shapes", STAGE_VERSIONS["shapes"], {"grid": grid.digest, **drawn})


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


def build_model(
    scene: Scene, sampler: GridSampler, store: StageStore, progress: Progress, judge: DepthRenderer | None = None
) -> ObjectPoseModel:
    """Build the grid of `sampler` and its contact shapes in `scene`, or load them from the store.

    The renderer `judge` decides which poses make enough contact, so the grid does not depend on the scene's renderer.
    By default, it is the scene's.
    """
    judge = scene.renderer if judge is None else judge
    grid = make_grid_key(scene, sampler)
    artifact = store.build(grid, lambda work: _sample_grid(work, scene, sampler, progress))
    contact = PoseGrid(np.array(artifact.load_array("T_sensor_object")), PoseMetric(scene.object))
    key = make_shapes_key(grid, scene, judge)
    judging, percent = replace(scene, renderer=judge), sampler.options.min_contact_percent
    rendered = store.build(key, lambda work: _render_all(work, contact, (scene, judging), percent, progress))
    shapes = ShapeBank(rendered, scene.geometry.max_depth_m)
    return ObjectPoseModel(PoseGrid(contact.T_sensor_object[shapes.kept], contact.metric), shapes, key)


def make_bank_key(shapes: StageKey, encoder: Encoder, press_depth_m: float, trained: str = "") -> StageKey:
    """Return the store key of the bank of contact shapes cut at `press_depth_m` metres.

    `trained` is the digest of the encoder's weights; empty for an encoder that needs no training.
    """
    encoded: dict[str, Any] = {"encoder": encoder.describe(), "trained": trained, "press_depth_m": press_depth_m}
    return StageKey("bank", STAGE_VERSIONS["bank"], {"shapes": shapes.digest, **encoded})


def build_bank(
    model: ObjectPoseModel,
    scene: Scene,
    encoder: Encoder,
    press_depth_m: float,
    store: StageStore,
    progress: Progress,
    trained: str = "",
) -> NDArray[np.float32]:
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

    If rays are parallel, the shapes at full press are cut at the lighter press. A pinhole camera sees a lighter press
    from farther away, so the shapes are rendered again.
    """
    press_m, deepest_m = pressed.geometry.indentation_m, model.shapes.max_depth_m
    if press_m == deepest_m or not pressed.geometry.is_pinhole:
        yield from model.shapes.shards(press_m)
        return
    poses = model.grid.raise_level(deepest_m - press_m).T_sensor_object
    for start in range(0, len(poses), SHARD):
        yield pressed.render_contact_depths(poses[start : start + SHARD], grid=True)


def _sample_grid(work: Workspace, scene: Scene, sampler: GridSampler, progress: Progress) -> None:
    with progress.task("sampling the pose grid", 1) as advance:
        work.save_array("T_sensor_object", make_contact_grid(sampler, scene).T_sensor_object, packed=True)
        advance(1)


def _render_all(
    work: Workspace, grid: PoseGrid, scenes: tuple[Scene, Scene], percent: float, progress: Progress
) -> None:
    """Render the grid shard by shard; skip the shards that an interrupted build finished.

    The first scene draws the contact shapes, and the second one decides which poses make enough contact.
    """
    scene, judging = scenes
    same = judging.renderer.describe() == scene.renderer.describe()
    kept: list[NDArray[Any]] = []
    sizes = []
    with progress.task("rendering contact shapes", len(grid)) as advance:
        for number, start in enumerate(range(0, len(grid), SHARD)):
            poses = grid.T_sensor_object[start : start + SHARD]
            name = _name_shard(number)
            codes = work.load(name)
            enough = work.load(f"{name}-enough", keep=False)
            if codes is None or enough is None:
                depths = scene.render_contact_depths(poses, grid=True)
                judged = depths if same else judging.render_contact_depths(poses, grid=True)
                enough = mark_contact(judged, judging, percent)
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
    inputs: dict[str, Any] = {"shapes": shapes.digest, "encoder": encoder.describe(), "sampler": sampler.describe()}
    return StageKey("encoder", STAGE_VERSIONS["encoder"], inputs)


def train_encoder(
    encoder: Encoder,
    key: StageKey | None,
    problem: Callable[[Checkpoints], TrainingProblem],
    store: StageStore,
    name: str = "",
) -> str:
    """Train `encoder` on a problem, or load the weights stored under `key`; return the weights' digest.

    If the encoder needs no training, `key` is None and the digest is empty. `name` is that of the object, for a
    message. Raises the errors of `Encoder.fit`.
    """
    if key is None:
        return ""

    def fit(work: Workspace) -> None:
        log.log(NOTE, "training the encoder%s; this takes minutes", f" of {name}" if name else "")
        encoder.fit(problem(WorkspaceCheckpoints(work)))
        work.save_file(WEIGHTS, encoder.save_weights)

    encoder.load_weights(store.build(key, fit).find_file(WEIGHTS))
    return key.digest


class ListedSource(PoseSource):
    """Poses listed by a grid, whose contact shapes are rendered and encoded only once."""

    all_stages = ("grid", "shapes", "encoder", "bank")
    may_miss = False

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages of the store that the source builds, the first ones first."""
        fits = self.setup.config.temperature is None and self.setup.encoder.capabilities.temperature is None
        return (*super().stages, *((temperature.STAGE,) if fits else ()))

    @cached_property
    def model(self) -> ObjectPoseModel:
        """The object's grid and contact shapes, stored or built now."""
        setup = self.setup
        return build_model(setup.coarse_scene, setup.sampler, setup.store, setup.progress, setup.judge)

    @cached_property
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""
        model, setup = self.model, self.setup
        scene, sampler, encoder = setup.coarse_scene, setup.sampler, setup.encoder
        if not encoder.capabilities.needs_training:
            return ""
        return train_encoder(
            encoder,
            make_encoder_key(model.key, encoder, sampler),
            lambda kept: ListedProblem(model.grid, scene, sampler, model.shapes.shards, setup.progress, kept),
            setup.store,
            scene.object.name,
        )

    @cached_property
    def banks(self) -> GridScores:
        """The comparison of touches with the grid's banks; each bank is built at first use, or loaded if stored."""
        deepest_m = self.setup.coarse_scene.geometry.max_depth_m
        return GridScores(self.setup.encoder, self.new_matcher, self._bank, deepest_m)

    def _bank(self, press_depth_m: float) -> Scores:
        setup = self.setup
        return build_bank(
            self.model, setup.coarse_scene, setup.encoder, press_depth_m, setup.store, setup.progress, self.trained
        )

    def matcher(self, press_depth_m: float) -> Matcher:
        """Return the matcher whose bank is cut at this press depth (metres), built at first use."""
        return self.banks.matcher(press_depth_m)

    def press_grid(self, touch: Touch) -> PoseGrid:
        """Return the grid's poses, in metres, at the touch's indentation."""
        return self.model.grid.raise_level(self.setup.coarse_scene.geometry.max_depth_m - touch.indentation_m)

    def score(self, touch: Touch, times: StageTimes, prior: Prior | None = None) -> tuple[PoseGrid, Scores]:
        """Match a touch with all poses of the grid."""
        return self.press_grid(touch), self.banks.score(touch, times)

    def propose(
        self, views: Sequence[View], alone: Posteriors, fused: PosePosterior, prior: Prior | None, top: int
    ) -> list[Mode]:
        """Return the modes of the fused posterior; for several touches, the poses that explain all of them best.

        The modes of one touch are split, because the poses of one mode may end in several poses when refined.
        """
        options, radius_m = self.setup.config.hypotheses, self.setup.start_radius_m
        if len(views) > 1:
            return propose_together(views, alone, fused, radius_m, options)
        return split_modes(fused, fused.modes(self.setup.mode_radius_m, top), radius_m, max(top, options.refined))

    def list_starts_alone(self, view: View, own: PosePosterior, times: StageTimes) -> tuple[PoseGrid, Values]:
        """Return the touch's most probable poses, and their log-probabilities."""
        listed = own.top(self.setup.config.hypotheses.listed)
        return PoseGrid(own.grid.T_sensor_object[listed], own.grid.metric), own.log_p[listed]

    def find_scaling(self) -> TemperatureScaling:
        """Return the scaling that the encoder ships, or one fitted to simulated touches of the object and stored."""
        shipped = self.setup.encoder.capabilities.temperature
        if shipped is not None:
            return TemperatureScaling(*shipped)
        artifact = self.setup.store.build(self.temperature_key(), self._fit_temperature)
        return TemperatureScaling(**artifact.load_json(temperature.STAGE))

    def temperature_key(self) -> StageKey:
        """Return the store key of the fitted scaling, made from all inputs of the fit."""
        touches = {"noise": temperature.TOUCH_NOISE.describe(), "touches": temperature.TOUCHES}
        inputs = {**self.describe_scores(), "sampler": self.setup.sampler.describe(), **touches}
        inputs |= {"batch": temperature.BATCH, "seed": temperature.SEED}
        return StageKey(temperature.STAGE, temperature.STAGE_VERSION, inputs)

    def _fit_temperature(self, work: Workspace) -> None:
        """Score simulated touches, and save the scaling that makes their true poses most probable."""
        sampler, scene, noise = self.setup.sampler, self.setup.scene, temperature.TOUCH_NOISE
        drawn = (
            touch
            for seed, count in temperature.list_batches()
            for touch in simulate_touches(sampler, scene, count, np.random.default_rng(seed), noise=noise)
        )
        scores, truth = [], []
        with self.setup.progress.task("fitting probabilities", temperature.TOUCHES) as advance:
            exact = ListedSource(self.setup, ExactMatcher)  # other matchers may leave out the true pose
            for found, index in map_in_threads(exact.score_truth, drawn):
                scores.append(found)
                truth.append(index)
                advance(1)
        fitted = temperature.fit_temperature_scaling(scores, np.array(truth))
        work.save_json(temperature.STAGE, asdict(fitted))

    def score_truth(self, touch: Touch) -> tuple[Scores, int]:
        """Return the scores of a simulated touch, and the index of the pose nearest to its true pose."""
        grid, found = self.score(touch, StageTimes())
        return found, int(grid.nearest(np.asarray(touch.T_sensor_object)[None])[1][0])

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the scores except sensor and touch, as JSON values; trains the encoder if necessary."""
        return {"model": self.model.key.digest, "trained": self.trained}

    def prepare(self, press_depth_m: float) -> None:
        """Build or load the bank of this press depth, metres, and train the encoder."""
        self.matcher(press_depth_m)

    def count_poses(self) -> dict[str, Any]:
        """Return the number of poses and their mean distance, metres; None for a single pose."""
        grid = self.model.grid
        some = np.arange(0, len(grid), max(1, len(grid) // MOST_MEASURED))
        spacing_m = float(grid.neighbour_spacing(some).mean()) if len(grid) > 1 else None
        return {"poses": len(grid), "mean_spacing_m": spacing_m}

    @property
    def listed(self) -> ListedSource:
        """The listed grid: this source."""
        return self
