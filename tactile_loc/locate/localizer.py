"""The localizer: the components that locate one object with its sensors, and the calls that use them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.places.places import Places
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.runtime.compiled import use_one_blas_thread
from tactile_loc.core.runtime.errors import ConfigError, GridError, NoContactError, TouchError, quote
from tactile_loc.core.runtime.progress import Progress, StageTimes
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.core.sensing.scene import Scene, View, view_touch
from tactile_loc.core.sensing.touch import Touch, require_fit
from tactile_loc.io.config import RunConfig, SlotConfig, choose_sensor
from tactile_loc.io.meshes.mesh_files import Units
from tactile_loc.io.touches import read_touch, touch_from_image
from tactile_loc.locate.method import Refinement
from tactile_loc.locate.preparation import TOUCHES, list_examples, list_presses
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.several_touches import compute_posterior_together, localize_together
from tactile_loc.locate.sources.listed_grid import ListedSource, ObjectPoseModel
from tactile_loc.locate.sources.source import FindPlaces, PoseSource, SourceSetup
from tactile_loc.locate.sources.whole_object import WholeObjectSource
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.simulate.resting_touches import draw_resting_touches, rest
from tactile_loc.simulate.touch_simulation import simulate_touches
from tactile_loc.slots.registry import SLOTS, registry
from tactile_loc.store.store import StageStore


class Localizer:
    """Locates one object with one sensor. Build it once, then use it for any number of touches.

    `for_sensor` adds sensors of other kinds. All calls that take several touches then take those of any of the sensors.

    Several threads may use one localizer. A localizer can be pickled, for instance for other processes. The copy loads
    what is in the store, so the store's folder must exist there. `find_places`, if given, returns the object's places
    for a grid that lists places. Otherwise, they are found once and stored.
    """

    def __init__(
        self,
        config: RunConfig,
        obj: ObjectModel,
        store: StageStore | None = None,
        progress: Progress | None = None,
        find_places: FindPlaces | None = None,
    ) -> None:
        self.config, self.object, self._find_places = config, obj, find_places
        self.store, self.progress = store or StageStore(), progress or Progress()
        made = {slot: self._create(slot) for slot in SLOTS}
        self.sensor, self.sampler, self.encoder, self.fuser = (made[k] for k in ("sensor", "grid", "encoder", "fuser"))
        self.registration = JointRegistration()
        self.refinement = Refinement(made["refiner"], config.refiner.name, self.registration)
        self.scene = Scene(obj, self.sensor.geometry, made["renderer"])
        self._components = made
        self._known: list[Localizer] = [self]  # the localizers of all sensors

    @cached_property
    def _setup(self) -> SourceSetup:
        store, progress = self.store, self.progress
        return SourceSetup(self.config, self.scene, self.sampler, self.encoder, store, progress, self._find_places)

    @classmethod
    def create(
        cls,
        object: str | Path = "hook",
        *,
        units: Units = "auto",
        symmetry: str = "auto",
        store: StageStore | str | Path | None = None,
        progress: Progress | None = None,
        prepared: bool = False,
        **settings: Any,
    ) -> Self:
        """Load an object (a mesh file, or a demo object's name) and make its localizer; `store` may be a folder.

        If `prepared`, do all work of the first calls now: see `prepare`.

        `settings` are the entries of RunConfig: slots by name (`refiner="icp"`) or with options (`grid={"name": "face",
        "spacing_mm": 3}`), `top`, `seed`, ... Raises TactileLocError for bad input.
        """
        chosen = {"path": str(object), "units": units, "symmetry": symmetry}
        config = RunConfig.from_dict({"object": chosen, **settings}, "Localizer.create")
        store = store if isinstance(store, StageStore) else StageStore(store)
        made = cls(config, load_stored_object(object, units, symmetry, store), store, progress)
        return made.prepare() if prepared else made

    def prepare(self) -> Self:
        """Build, load and compile what calls with touches of all sensors need, and return the localizer.

        After it, no call compiles, fits, or reads from the disk. The first time takes about a minute if nothing is
        compiled yet, and later times a few seconds. The localizer's progress shows it.
        """
        works = [(one, press_m) for one in self._known for press_m in one._list_presses()]
        with self.progress.task("prepare: presses", len(works)) as advance:
            for one, press_m in works:
                one.source.prepare(press_m)
                advance(1)
        taken = [rest(one.simulate(TOUCHES, self.config.seed, noise="mild"), np.eye(4)) for one in self._known]
        masks = not self.encoder.capabilities.needs_training  # trained encoders compare depths
        examples = [example for touches in taken for example in list_examples(touches, masks)]
        examples.append(([touches[0] for touches in taken], {}))
        with self.progress.task("prepare: examples", len(examples)) as advance:
            for given, asked in examples:
                with suppress(GridError):
                    str(self.localize(given, **asked))
                advance(1)
        return self

    def _list_presses(self) -> list[float]:
        return list_presses(self.scene.geometry.max_depth_m, self.encoder.capabilities.needs_training)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle only what the localizer was made from. The copy makes its components and loads the rest, if stored."""
        made_from = self.config, self.object, self.store, self.progress, self._find_places
        return type(self), made_from, [one.config.sensor for one in self._known if one is not self]

    def __setstate__(self, sensors: Sequence[SlotConfig]) -> None:
        for sensor in sensors:
            self._add_sensor(sensor)

    def for_sensor(self, sensor: str | dict[str, Any]) -> Localizer:
        """Return the localizer of the same object for another sensor, made at the first call.

        `sensor` is a name, the path of the sensor's file or folder, or a name with options, as in `create`. From then
        on, touches of both sensors can be located together, by either localizer. Raises ConfigError for an unknown
        sensor.
        """
        return self._add_sensor(choose_sensor(sensor) if isinstance(sensor, str) else SlotConfig(**sensor))

    def _add_sensor(self, sensor: SlotConfig) -> Localizer:
        known = next((one for one in self._known if one.config.sensor == sensor), None)
        if known is None:
            config = self.config.model_copy(update={"sensor": sensor})
            known = type(self)(config, self.object, self.store, self.progress, self._find_places)
            self._known.append(known)
            known._known = self._known
        return known

    def find_localizer(self, touch: Touch) -> Localizer:
        """Return the localizer of a touch's sensor: this one, or that of `for_sensor`. Raises TouchError if unknown."""
        fits = (one for one in (self, *self._known) if isinstance(touch, Touch) and one._has_taken(touch))
        found = next(fits, self)
        found.require_own(touch)
        return found

    def _has_taken(self, touch: Touch) -> bool:
        ours = self.scene.geometry
        return touch.geometry is ours or touch.geometry.is_same_sensor(ours)

    def describe_components(self) -> dict[str, Any]:
        """Return the description of each slot's component, with a hash of its code, as JSON values."""
        return {slot: component.describe() for slot, component in self._components.items()}

    def _create(self, slot: str) -> Any:
        chosen = getattr(self.config, slot)
        return registry().create(slot, chosen.name, chosen.options)

    # touches

    def read_touch(
        self, path: str | Path, unit: str | None = None, press_depth_m: float | None = None, kind: str | None = None
    ) -> Touch:
        """Read a contact shape (npz, npy, 16-bit PNG) as a touch of this sensor. Raises TouchError for a bad file.

        `kind` is the meaning of the depths if the file does not state it: see `Touch.from_depth`.
        """
        return read_touch(Path(path), self.sensor, unit, press_depth_m, kind)

    def find_touch(self, image: NDArray[Any], T_base_sensor: Poses | None = None, name: str = "touch") -> Touch | None:
        """Return the touch in an image (H, W, 3) uint8, or in depths (H, W), of this sensor; None without contact.

        `T_base_sensor` (4, 4), metres, is the sensor's pose. The configuration of a touch states the unit, the kind and
        the press depth of depths, as in `Localizer.create(..., touch={"unit": "mm", "kind": "indentation"})`. Raises
        TouchError if the image cannot be read.
        """
        asked = self.config.touch
        if image.ndim == 2:
            require_fit(image.shape, self.scene.geometry, name)  # an array of the wrong size may show no contact, too
        try:
            touch = touch_from_image(image, self.sensor, asked.press_depth_m, name, asked.unit, asked.kind)
        except NoContactError:
            return None
        return replace(touch, T_base_sensor=T_base_sensor)

    def simulate(
        self, count: int = 1, seed: int = 0, press_depth_m: float | None = None, noise: str = "none"
    ) -> list[Touch]:
        """Simulate touches with known true poses, drawn at random from the continuous set that the grid covers.

        `noise` is none, mild or strong. Raises ConfigError for another noise, or for a count or seed below 0.
        """
        rng = _make_generator(count, seed)
        return simulate_touches(self.sampler, self.scene, count, rng, press_depth_m, make_noise(noise))

    def simulate_together(
        self,
        count: int = 3,
        seed: int = 0,
        press_depth_m: float | None = None,
        noise: str = "none",
        opposed: bool = False,
    ) -> list[Touch]:
        """Simulate touches of one object at rest, with known true poses and sensor poses `T_base_sensor`.

        The touches are drawn as by `simulate`. With `opposed`, they are pairs of a gripper's two fingers, so that the
        second sensor of a pair faces the first. Raises as `simulate`, and TouchError for an odd number of opposed
        touches.
        """
        rng = _make_generator(count, seed)
        return draw_resting_touches(self.sampler, self.scene, count, rng, press_depth_m, make_noise(noise), opposed)

    def require_own(self, touch: Touch) -> None:
        """Raise TouchError unless `touch` is a Touch of this sensor."""
        if not isinstance(touch, Touch):
            raise TouchError(f"{quote(touch)} is not a Touch; read one from a file with `Localizer.read_touch`")
        if not touch.has_depths and self.encoder.capabilities.needs_training:
            raise TouchError(
                f"{touch.name} is a contact mask, but the encoder {self.config.encoder.name!r} is trained on depths; "
                "choose `encoder` pixel"
            )
        if not self._has_taken(touch):
            names = ", ".join(one.config.sensor.name for one in self._known)
            raise TouchError(
                f"{touch.name} was not taken by the sensor {names}: its camera, field, gel or maximal depth differs; "
                "call `for_sensor` with that sensor first"
            )

    # parts that are built once

    @cached_property
    def source(self) -> PoseSource:
        """The source of candidate poses: a listed grid, or a search of the whole object."""
        kind = WholeObjectSource if self.sampler.capabilities.places else ListedSource
        return kind(self._setup, lambda: self._create("matcher"))

    @property
    def loaded_bytes(self) -> int:
        """The memory, bytes, of the places and banks of a search of the whole object."""
        return self.source.nbytes if "source" in self.__dict__ else 0

    @property
    def listed(self) -> ListedSource:
        """The listed grid. Raises ConfigError if the grid lists places, not poses."""
        return cast(ListedSource, self.source.listed)

    @property
    def places(self) -> Places:
        """The places of the object that are searched. Raises ConfigError if the grid lists poses."""
        places: Places = self.source.searched.places
        return places

    @property
    def model(self) -> ObjectPoseModel:
        """The object's listed grid and contact shapes, stored or built now. Raises ConfigError as `listed` does."""
        return self.listed.model

    @property
    def coarse_scene(self) -> Scene:
        """The scene with the few pixels of a listed grid's contact shapes, at full press."""
        return self._setup.coarse_scene

    @property
    def mode_radius_m(self) -> float:
        """Distance below which poses belong to one mode, metres."""
        return self._setup.mode_radius_m

    def make_views(self, touches: Sequence[Touch]) -> list[View]:
        """Return the views of touches of the localizer's sensors, in the sensor frame of the first touch."""
        scenes = [self.find_localizer(touch).scene.match_touch(touch) for touch in touches]
        return [view_touch(touches[0], touch, scene) for touch, scene in zip(touches, scenes, strict=True)]

    # answers

    def localize(
        self,
        touches: Touch | Sequence[Touch],
        prior: Prior | None = None,
        top: int | None = None,
        coverage: float | None = None,
        starts: Poses | None = None,
        searches: bool = True,
    ) -> Localization:
        """Return the posterior over poses given a touch, or several, and its `top` distinct hypotheses, refined.

        The touches are of the localizer's sensors, and several touches need `T_base_sensor`. `prior` maps poses
        (N, 4, 4) in metres to log-weights (N,). With a `coverage`, 0 to 1, the hypotheses are a set that contains the
        true pose with that probability: see `PoseSet`. `starts` and `searches` are as for `localize_together`. Raises
        TactileLocError if no pose fits the touches.
        """
        given = touches if isinstance(touches, list | tuple) else [cast(Touch, touches)]
        observations = [(self.find_localizer(touch), touch) for touch in given]
        return localize_together(observations, prior, top, coverage, starts, searches)

    def locate(
        self, touches: Touch | Sequence[Touch | None] | None, time_s: float | None = None, top: int | None = None
    ) -> LocatedFrame:
        """Locate the touches of one frame, for a control loop. A frame without contact, or without a pose, is a result.

        `touches` has an entry for each finger; None is a finger without contact (see `find_touch`). The pose is that
        of `localize`, and at most `top` are listed. `time_s` is the frame's time, by default the present time since
        1970. Raises TactileLocError for a touch that cannot be located, such as one of another sensor.
        """
        start, time_s = time.perf_counter(), time.time() if time_s is None else time_s
        try:
            found = LocatedFrame.of(self.localize(require_contact(touches), top=top))
        except (NoContactError, GridError) as error:
            found = LocatedFrame.of_error(error)
        return replace(found, time_s=time_s, seconds=time.perf_counter() - start)

    def find_most_probable_pose(
        self, touches: Touch | Sequence[Touch | None] | None, time_s: float | None = None
    ) -> LocatedFrame:
        """Return the first pose of `locate`, with its verdict and covariance, for a control loop."""
        return self.locate(touches, time_s, top=1)

    def posterior(self, touch: Touch, prior: Prior | None = None, times: StageTimes | None = None) -> PosePosterior:
        """Return the posterior over the grid's poses given a touch and a prior. Adds stage durations to `times`."""
        return compute_posterior_together([(self, touch)], prior, times)

    @use_one_blas_thread()
    def posterior_alone(self, touch: Touch) -> PosePosterior:
        """Return a touch's own posterior over the grid's poses, before fusion."""
        return self.source.search(self.make_views([touch]), [self.source], StageTimes())[0]

    @use_one_blas_thread()
    def refine(self, touch: Touch, posterior: PosePosterior, indices: Sequence[int]) -> list[RefinedPose]:
        """Refine poses of the posterior's grid, given by `indices`, against the touch; return them in this order."""
        poses = posterior.grid.T_sensor_object
        candidates = [Candidate(poses[index], int(index), float(posterior.log_p[index])) for index in indices]
        return self.refinement.refine(self.make_views([touch]), candidates)


def require_contact(touches: Touch | Sequence[Touch | None] | None) -> list[Touch]:
    """Return the touches of the fingers in contact. Raises NoContactError if there is none."""
    given = touches if isinstance(touches, list | tuple) else [cast(Touch | None, touches)]
    found = [touch for touch in given if touch is not None]
    if not found:
        raise NoContactError("nothing touches the sensor; press it onto the object")
    return found


def _make_generator(count: int, seed: int) -> np.random.Generator:
    """Return the random generator of `count` simulated touches. Raises ConfigError for a count or seed below 0."""
    if min(count, seed) < 0:
        raise ConfigError(f"cannot simulate {count} touches with seed {seed}; give whole numbers, 0 or more")
    return np.random.default_rng(seed)
