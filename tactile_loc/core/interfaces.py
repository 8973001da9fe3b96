"""The seven slots, and the scene, an object before a sensor.

A component gets its own options and nothing of anybody else's; results are frozen dataclasses.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.explained import Explained, explained
from tactile_loc.core.geometry import invert
from tactile_loc.core.objects import ObjectModel, TriangleMesh
from tactile_loc.core.places import Places
from tactile_loc.core.poses import PoseGrid, Poses
from tactile_loc.core.posterior import PosePosterior
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing import Drawing, SensorGeometry, as_drawn
from tactile_loc.core.touch import ContactShape, Touch, contact_depth

Float32 = NDArray[np.float32]

IOU_PX = 100
# Of an indentation, what its measurement may be off by: a pose is as good if it explains a touch that much deeper.
PRESS_ERROR, LEAST_PRESS_ERROR_M = 0.2, 5e-5


class ComponentOptions(BaseModel):
    """Base of every component's options: frozen, no infinity or NaN, unknown keys refused.

    A field's description states its unit. One that cannot change any result, such as where to compute, says so with
    `json_schema_extra={"neutral": True}`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def neutral(cls) -> set[str]:
        """Return the names of the options that cannot change any result."""
        extras = {name: field.json_schema_extra for name, field in cls.model_fields.items()}
        return {name for name, extra in extras.items() if isinstance(extra, dict) and extra.get("neutral")}


@dataclass(frozen=True)
class Capabilities:
    """What a component can and cannot do, so that nobody has to probe it.

    `exact_undercuts`: a renderer sees surfaces below overhangs. `deterministic`: same input, same output.
    `follows_press_depth`: an encoder's bank must be encoded at the touch's own press depth.
    `top_k_only`: a matcher scores only some poses, the others are -inf. `needs_training`: `fit` does work.
    `refines`: a refiner moves poses, unlike the null one. `contact_only`: a fuser asks only which poses touch a sensor,
    not how probable they are. `places`: a grid lists the object's places instead of poses. `uses_normals`,
    `differentiable`, `device`: as they say.
    """

    deterministic: bool = True
    exact_undercuts: bool = True
    follows_press_depth: bool = False
    top_k_only: bool = False
    needs_training: bool = False
    refines: bool = True
    contact_only: bool = False
    places: bool = False
    uses_normals: bool = False
    differentiable: bool = False
    device: str = "cpu"


class Component(ABC):
    """Base of all components. `version` is part of the store's keys: raise it when the same input gives new output."""

    slot: ClassVar[str]
    version: ClassVar[int] = 1
    capabilities: ClassVar[Capabilities] = Capabilities()

    class Options(ComponentOptions):
        """No options."""

    def __init__(self, options: ComponentOptions | None = None) -> None:
        self.options: Any = options if options is not None else self.Options()

    def describe(self) -> dict[str, Any]:
        """Return what identifies this component's output (class, version, options), as JSON values.

        Options that are marked neutral are left out: they change where or how it computes, not what comes out.
        """
        kind = f"{type(self).__module__}:{type(self).__qualname__}"
        options = self.options.model_dump(mode="json", exclude=self.options.neutral())
        return {"class": kind, "version": self.version, "options": options}


class SensorModel(Component):
    """A tactile sensor: its geometry, and how an observation becomes a contact shape."""

    slot = "sensor"

    @property
    @abstractmethod
    def geometry(self) -> SensorGeometry:
        """The camera behind the sensing surface (metres, pixels)."""

    @abstractmethod
    def contact_shape(self, image: NDArray[Any]) -> ContactShape:
        """Turn an observation, an image (H, W, 3) uint8 or depths (H, W) in metres, into a contact shape.

        Raises TouchError when the observation does not fit.
        """

    def simulated_image(self, shape: ContactShape, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return the image (H, W, 3) that the sensor's camera would take of a contact shape, with its noise.

        Raises ConfigError unless the sensor reads images, CalibrationError when none can be made for it.
        """
        raise ConfigError(
            f"the sensor {type(self).__name__} reads no images; make one that does with tactile-loc calibrate "
            "--simulated and give its folder as --sensor"
        )


class Renderer(Component):
    """Draws the object as the sensor's camera would see it."""

    slot = "renderer"

    @abstractmethod
    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depth z (N, H, W) in metres at pixel centres for poses (N, 4, 4).

        Exact between standoff and standoff + max_depth; anything beyond may be inf. Poses are in contact already.
        """

    def render_apart(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return what `render` returns (N, H, W), metres, of poses that share no rotation: random ones, or a refiner's.

        Override it where these can be drawn faster or more exactly than the poses of a grid.
        """
        return self.render(mesh, T_sensor_object, geometry)


@dataclass(frozen=True, eq=False)
class Scene:
    """The object, the sensor's geometry and the renderer that draws the one for the other, pressed or as in the paper.

    Poses are those of the pressed object either way: see `as_drawn`.
    """

    object: ObjectModel
    geometry: SensorGeometry
    renderer: Renderer
    drawing: Drawing = "pressed"

    def as_seen(self) -> Scene:
        """Return the scene that draws what the sensor really sees, as touches show it."""
        return dataclasses.replace(self, drawing="pressed")

    def in_contact(self, T_sensor_object: Poses) -> tuple[Poses, NDArray[np.bool_]]:
        """Bring poses (N, 4, 4) to contact along z; also return which (N,) touch the sensing rectangle. Metres."""
        from tactile_loc.core.contact import bring_to_contact

        return bring_to_contact(self.object.mesh, T_sensor_object, self.geometry)

    def nearly_in_contact(self, T_sensor_object: Poses, most_m: float) -> Poses:
        """Move poses (N, 4, 4) along z towards contact, by at most `most_m` metres."""
        T, touching = self.in_contact(T_sensor_object)
        by_m = T[:, 2, 3] - T_sensor_object[:, 2, 3]
        T[:, 2, 3] = T_sensor_object[:, 2, 3] + np.where(touching, np.clip(by_m, -most_m, most_m), 0.0)
        return T

    def pressed(self, indentation_m: float, press_depth_m: float | None = None) -> Scene:
        """Return the scene with the object pressed in: see `SensorGeometry.pressed`. Metres."""
        return dataclasses.replace(self, geometry=self.geometry.pressed(indentation_m, press_depth_m))

    def of_touch(self, touch: Touch) -> Scene:
        """Return the scene as the touch's sensor sees it: pressed as deep, with as many pixels."""
        return dataclasses.replace(self, geometry=touch.geometry)

    def contact_depths(self, T_sensor_object: Poses, press_depth_m: float | None = None) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres of poses (N, 4, 4) that are in contact already."""
        T, camera = as_drawn(T_sensor_object, self.geometry, self.drawing)
        depth = self.renderer.render_apart(self.object.mesh, T, camera.band)
        return contact_depth(depth, camera, camera.max_depth_m if press_depth_m is None else press_depth_m)

    def grid_depths(self, T_sensor_object: Poses) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres, at full press, of a grid's poses: many share a rotation."""
        T, camera = as_drawn(T_sensor_object, self.geometry, self.drawing)
        return contact_depth(self.renderer.render(self.object.mesh, T, camera.band), camera, camera.max_depth_m)

    def depths_explaining(self, T_sensor_object: Poses, touch: Touch, freedom_m: float = 0.0) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres of poses (N, 4, 4) as they are compared with a touch.

        A pose counts as it is, but for what the measured press may be off by, and `freedom_m` metres more.
        """
        freedom_m += LEAST_PRESS_ERROR_M + PRESS_ERROR * touch.indentation_m
        return self.contact_depths(self.nearly_in_contact(T_sensor_object, freedom_m), touch.press_depth_m)

    def contact_shape(self, T_sensor_object: NDArray[np.float64], press_depth_m: float) -> ContactShape:
        """Render the contact shape of one pose (4, 4), brought to contact, cut at `press_depth_m` metres.

        It is pressed in as deep as the scene says, or by the press depth where the scene is that of no touch.
        """
        pressed = self if self.geometry.indentation_m else self.pressed(press_depth_m)
        T, _ = pressed.in_contact(T_sensor_object[None])
        return ContactShape(pressed.contact_depths(T, press_depth_m)[0], press_depth_m, pressed.geometry.indentation_m)

    def contact_iou(self, T_sensor_object: NDArray[np.float64], touch: Touch) -> float:
        """Return the contact IoU of one pose (4, 4), metres: see `contact_ious`."""
        return self.contact_ious(T_sensor_object[None], touch)[0]

    def contact_ious(self, T_sensor_object: Poses, touch: Touch) -> list[float]:
        """Return how well each of the poses (N, 4, 4), metres, explains a touch: 0 (not at all) to 1, unitless.

        The intersection over union of the touch's contact and the one that the pose makes, where the sensor observes,
        on about IOU_PX pixels a side. A pose counts as it is, but for what the measured press may be off by: one that
        hovers over the sensor explains nothing.
        """
        return self.explained(T_sensor_object, touch).contact_ious.tolist()

    def imprint_ious(self, T_sensor_object: Poses, touch: Touch) -> NDArray[np.float64]:
        """Return how well poses (N, 4, 4), metres, explain a touch in depth and outline: (N,), 0 to 1, unitless.

        A generalised intersection over union: the sum of the smaller over the sum of the larger of what pose and touch
        press in, raised by OUTLINE_SHARE of the press depth wherever there is contact; otherwise as `contact_ious`.
        """
        return self.explained(T_sensor_object, touch).imprint_ious

    def explained(
        self, T_sensor_object: Poses, touch: Touch, pixels: int = IOU_PX, freedom_m: float = 0.0
    ) -> Explained:
        """Return how well poses (N, 4, 4), metres, which are drawn once, explain a touch: IoUs, and evidence.

        Poses may be `freedom_m` metres farther off along z than the measured press allows.
        """
        geometry, wanted = touch.thinned(pixels)
        made = dataclasses.replace(self, geometry=geometry).depths_explaining(T_sensor_object, touch, freedom_m)
        return explained(made, wanted.depth_m, touch.press_depth_m, geometry.observed_mask, geometry.pixel_pitch_m)


class GridSampler(Component):
    """Proposes the contact poses to search."""

    slot = "grid"

    class Options(ComponentOptions):
        """What every grid has: how dense it is, and how much contact a pose must make."""

        spacing_mm: float = Field(default=3.0, gt=0, description="mean distance between neighbouring poses, mm")
        min_contact_percent: float = Field(
            default=0.25, ge=0, le=100, description="least share of the observed pixels in contact, percent"
        )

    @property
    def spacing_is_mean(self) -> bool:
        """Whether `spacing_mm` is the mean over the whole grid, which core then corrects for what contact does to it.

        False where options set some steps apart from it, as tilts or a level of rotations.
        """
        return True

    @abstractmethod
    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return candidate poses (N, 4, 4), about `spacing_m` metres apart; z is free, core brings them to contact."""

    def places(self, obj: ObjectModel, progress: Progress) -> Places:
        """Return the places of an object that can touch first: what is searched if `Capabilities.places` is declared.

        Poses are not listed then: a touch shows where its deepest point is, and is turned by each of `options.turns`
        yaws. `sample` and `random` are of the set of poses that this covers.
        """
        raise NotImplementedError(f"{type(self).__name__} lists poses")

    @abstractmethod
    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw `count` poses (count, 4, 4) uniformly from the continuous set that the grid samples; z is free.

        As many are drawn about each pose of the grid: probabilities fitted to touches at such poses, P(x | touch), have
        a uniform P_train, which fusers take for granted where a posterior has no `log_train`. A rotation that has more
        places over the sensor must be drawn more often: see `random_places`.
        """


class Checkpoints:
    """Where a training keeps its state, so that it can go on after an interruption. This one forgets everything."""

    def load(self) -> Path | None:
        """Return the file that was saved last and is intact, or None."""
        return None

    def save(self, write: Callable[[Path], object]) -> None:
        """Replace the saved file, atomically, by what `write(path)` writes."""


@dataclass(frozen=True, eq=False)
class TrainingProblem:
    """What an encoder may learn from, all of it simulation.

    `grid` and `shapes`, the contact depths (S, H, W) in metres of its poses at full press, shard by shard in its order;
    fresh poses from `sampler`, rendered through `scene`.
    """

    grid: PoseGrid
    scene: Scene
    sampler: GridSampler
    shapes: Callable[[], Iterable[Float32]]
    progress: Progress = field(default_factory=Progress)
    checkpoints: Checkpoints = field(default_factory=Checkpoints)


class Encoder(Component):
    """Maps contact shapes to vectors whose Euclidean distance says how alike the poses are."""

    slot = "encoder"

    def fit(self, problem: TrainingProblem) -> None:
        """Learn from simulation. Does nothing unless the encoder needs training."""

    def save_weights(self, path: Path) -> None:
        """Write what `fit` learned to a safetensors file. Encoders that need no training have nothing to write."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    def load_weights(self, path: Path) -> None:
        """Read what `save_weights` wrote, instead of calling `fit`. Raises WeightsError for another encoder's file."""
        raise NotImplementedError(f"{type(self).__name__} has no weights")

    @abstractmethod
    def encode(self, depth_m: Float32, press_depth_m: float, geometry: SensorGeometry) -> Float32:
        """Return embeddings (N, D) of contact depths (N, H, W) in metres, all cut at one press depth."""

    def encode_seen(
        self, depth_m: Float32, seen: NDArray[np.bool_], press_depth_m: float, geometry: SensorGeometry
    ) -> tuple[Float32, Float32]:
        """Return embeddings (N, D) of contact depths of which pixels `seen` (N, H, W) are known, and weights (N, D).

        The weights, 0 to 1, say how far each number is known. By default all are, and the rest is out of contact.
        """
        embeddings = self.encode(np.where(seen, depth_m, np.float32(press_depth_m)), press_depth_m, geometry)
        return embeddings, np.ones_like(embeddings)


class Matcher(Component):
    """Compares queries with the bank. A score is -1/2 ||query - row||^2: for unit vectors, the cosine minus one."""

    slot = "matcher"

    @abstractmethod
    def index(self, bank: Float32) -> None:
        """Take the bank (N, D), one row a grid pose."""

    @abstractmethod
    def scores(self, queries: Float32) -> Float32:
        """Return scores (M, N) of queries (M, D), unitless, higher is more alike; -inf where it did not look."""

    def weighted_scores(self, queries: Float32, weights: Float32) -> Float32:
        """Return scores (M, N), -1/2 sum w (q - b)^2, of queries (M, D) of which weights (M, D), 0 to 1, are known.

        Raises ConfigError for a matcher that cannot weigh.
        """
        if (weights == 1).all():
            return self.scores(queries)
        raise ConfigError(
            f"the matcher {type(self).__name__} cannot leave out what a sensor does not see; choose dense, or a grid "
            "that lists its poses, such as face or hopf"
        )


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose to refine: `T_sensor_object` (4, 4) in metres, its grid index and log-probability."""

    T_sensor_object: NDArray[np.float64]
    index: int
    log_p: float


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """A refined pose (4, 4) in metres. `contact_iou`, 0 to 1 (unitless), tells how well it explains the touch's
    outline: `Scene.contact_iou`, the mean over several touches.

    `T_sensors_object` (N, 4, 4), metres, is where each sensor of several touches sees the object, if the refiner solves
    for the errors of sensor poses; None: where they are said to be.
    `covariance` (6, 6), if the refiner knows it, is that of the error of x, y, z of the object frame's origin (m) and
    of a rotation vector (rad), both along the sensor's axes: the order and frame of ROS's PoseWithCovariance.
    """

    T_sensor_object: NDArray[np.float64]
    contact_iou: float
    converged: bool
    iterations: int
    covariance: NDArray[np.float64] | None = None
    T_sensors_object: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class View:
    """One of several touches: what it shows, the object before its sensor, and where that is seen from the first.

    This sensor's pose is off by an error whose standard deviations are `sensor_std_m` metres along and `sensor_std_rad`
    radians about each axis, each sensor's by its own: `T_sensor_first` (4, 4), metres, by this one's and the first's.
    """

    touch: Touch
    scene: Scene
    T_sensor_first: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    sensor_std_m: float = 0.0
    sensor_std_rad: float = 0.0

    def explained(self, T_first_object: Poses, pixels: int = IOU_PX, freedom_m: float = 0.0) -> Explained:
        """Return how well poses (N, 4, 4) in the first sensor's frame, metres, explain this touch: see Scene's."""
        return self.scene.explained(self.T_sensor_first @ T_first_object, self.touch, pixels, freedom_m)

    def imprint_ious(self, T_first_object: Poses, pixels: int = IOU_PX, freedom_m: float = 0.0) -> NDArray[np.float64]:
        """Return the imprint IoUs (N,) of poses (N, 4, 4) in the first sensor's frame, metres: see `explained`."""
        return self.explained(T_first_object, pixels, freedom_m).imprint_ious


class Refiner(Component):
    """Moves a candidate below the grid's resolution."""

    slot = "refiner"

    @abstractmethod
    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the refined pose; `converged` is False when nothing better than the candidate was found."""

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, in their order; the same as `refine` one by one.

        Override it where candidates together are faster than one after another.
        """
        return [self.refine(touch, candidate, scene) for candidate in candidates]

    def refine_together(self, views: Sequence[View], candidates: Sequence[Candidate]) -> list[RefinedPose]:
        """Refine candidates, poses in the first touch's sensor frame, against several touches.

        Each touch refines all of them. What one touch gains by that others may lose: of these poses and the candidate
        itself the one is taken that all touches together like best. Override it to regard all touches at once.
        """
        if len(views) == 1:
            return self.refine_many(views[0].touch, candidates, views[0].scene)
        rows = [[RefinedPose(c.T_sensor_object, 0.0, False, 0) for c in candidates]]
        for view in views:
            T_first_sensor = invert(view.T_sensor_first)
            seen = [dataclasses.replace(c, T_sensor_object=view.T_sensor_first @ c.T_sensor_object) for c in candidates]
            found = self.refine_many(view.touch, seen, view.scene)
            rows.append([dataclasses.replace(r, T_sensor_object=T_first_sensor @ r.T_sensor_object) for r in found])
        poses = np.array([[r.T_sensor_object for r in row] for row in rows])
        ious = np.array([np.mean([view.imprint_ious(T) for view in views], axis=0) for T in poses])
        best = ious.argmax(axis=0)
        return [rows[b][k] for k, b in enumerate(best)]


Prior = Callable[[Poses], NDArray[np.float64]]


class Fuser(Component):
    """Combines the posteriors of several touches and a prior."""

    slot = "fuser"

    @abstractmethod
    def fuse(
        self, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
    ) -> PosePosterior:
        """Return the posterior over the first touch's grid. `prior` maps its poses (N, 4, 4) to log-weights (N,).

        `T_base_sensor` (4, 4) in metres is where each touch's sensor was, None if unknown. Raises ConfigError for
        touches that it cannot combine, such as several of unknown sensor poses, and GridError when no pose is left.
        """
