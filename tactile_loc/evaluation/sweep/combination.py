"""The combinations of a plan: their order, their keys, and the jobs that evaluate them."""

import itertools
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.evaluation import protocol
from tactile_loc.evaluation.metrics import LEVELS
from tactile_loc.evaluation.protocol import LINES, PROTOCOL_VERSION, evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.summary import measure_coverage, summarise_lines
from tactile_loc.evaluation.sweep.plan import Plan
from tactile_loc.evaluation.sweep.uncertainty import estimate_median
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.io.config import EXACT, ObjectConfig, RunConfig, SlotConfig, TouchConfig
from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.locate.localizer import Localizer
from tactile_loc.slots.component import Component
from tactile_loc.slots.registry import SLOTS, registry
from tactile_loc.store.keys import hash_arrays, hash_shortly, write_canonical_json
from tactile_loc.store.store import StageStore

ROW_VERSION = 3  # increase it if the same combination gets other results
STATISTICS = ("median_mm", "low_mm", "high_mm", "mean_mm", "median_share")
ERRORS = tuple(f"{line}_{what}" for line in LINES for what in STATISTICS)
COVERAGES = tuple(f"coverage_{100 * level:.0f}" for level in LEVELS)
# the stages that the pose of a line needs; those before refinement for all other lines
LINE_STAGES = {"reg-1": protocol.STAGES, "chosen": protocol.TIMED, "reg-10": protocol.TIMED}
SEARCHED = tuple(stage for stage in protocol.STAGES if stage != "refine")
TIMED_LINES = ("best-1", "reg-1", "chosen")
TIMES = (
    *(f"{stage}_ms" for stage in protocol.TIMED),
    *(f"{line}_{what}" for line in TIMED_LINES for what in ("ms", "low_ms", "high_ms")),
)
TOUCHES = "touches"  # the entry of a row's file with a value of each touch
IDS = ("grid_id", "touches_id")
HASHED_DECIMALS = 6  # of poses, metres


@dataclass(frozen=True)
class Combination:
    """One row of a sweep: an object, a component for each slot, a noise, a seed, and a number of touches.

    `config` has all settings, and `count` is the number of touches. `key` is a hash of all inputs of the row. `place`
    has the index of each value along its axis of the plan.
    """

    object: str
    config: RunConfig
    count: int
    key: str
    place: tuple[int, ...]

    def describe(self) -> dict[str, Any]:
        """Return every setting as JSON values."""
        return {**self.config.model_dump(mode="json", exclude={"top"}), "count": self.count}


def combine(plan: Plan) -> tuple[list[Combination], dict[str, ObjectModel]]:
    """Return all combinations, ordered by object, slots, noise and seed, and the objects by name.

    All meshes are read and all components made, so errors appear now. Raises TactileLocError for bad input, and for a
    grid that lists no poses.
    """
    objects = _load(plan.objects)
    described: dict[str, tuple[Component, Any]] = {}
    axes = [objects.items(), *plan.slots.values(), plan.noises, plan.seeds]
    combinations = []
    for places in itertools.product(*(list(enumerate(axis)) for axis in axes)):
        place, values = zip(*places, strict=True)
        (obj_config, obj), noise, seed = values[0][1], values[-2], values[-1]
        config = RunConfig(
            object=obj_config,
            touch=TouchConfig(noise=noise),
            seed=seed,
            **plan.settings,
            **dict(zip(plan.slots, values[1:-2], strict=True)),
        )
        key = make_combination_key(config, obj, plan.count, describe_components(config, described))
        combinations.append(Combination(obj.name, config, plan.count, key, place))
    return combinations, {obj.name: obj for _, obj in objects.values()}


def order_for_running(combinations: Iterable[Combination]) -> list[Combination]:
    """Return combinations in an order in which neighbours share little.

    Neighbours have different objects if possible, then different sensors, and so on. Workers then seldom wait for each
    other's stages, and an interrupted sweep has rows of all kinds.
    """
    return sorted(combinations, key=lambda combination: combination.place[::-1])


def make_combination_key(config: RunConfig, obj: ObjectModel, count: int, components: Mapping[str, Any]) -> str:
    """Return a hash of all inputs of a row; `components` is the result of `describe_components`."""
    settings = config.model_dump(mode="json", exclude={"object", "top"})
    return hash_shortly(
        {
            "version": ROW_VERSION,
            "touches": EXACT.model_dump(mode="json"),
            "tactile-loc": version("tactile-loc"),
            "protocol": PROTOCOL_VERSION,
            "count": count,
            "object": {"name": obj.name, **obj.describe()},
            "settings": settings,
            "components": components,
            "noise": make_noise(config.touch.noise).describe(),
        }
    )


def describe_components(config: RunConfig, known: dict[str, tuple[Component, Any]] | None = None) -> dict[str, Any]:
    """Return the description of each slot's component, and of the sensor's geometry.

    `known` keeps the components for later calls. Raises TactileLocError for a component that cannot be made, and for a
    grid that lists no poses.
    """
    known = {} if known is None else known
    described = {}
    for slot in SLOTS:
        chosen: SlotConfig = getattr(config, slot)
        name = write_canonical_json({"slot": slot, **chosen.model_dump()})
        if name not in known:
            component = registry().create(slot, chosen.name, chosen.options)
            geometry = {"geometry": component.geometry.describe()} if slot == "sensor" else {}
            known[name] = component, {**component.describe(), **geometry}
        component, described[slot] = known[name]
        if component.capabilities.places:
            raise ConfigError(
                f"a sweep needs a grid that lists its poses, but {chosen.name!r} does not; choose another, such as face"
            )
    return described


def choose_touches(config: RunConfig) -> SimulatedTouches:
    """Return the touches of a combination. An exact renderer draws them, whatever renderer the combination has."""
    return SimulatedTouches(config.touch.noise, config.seed, renderer=EXACT)


def identify(localizer: Localizer, touches: SimulatedTouches, table: ExampleTable) -> dict[str, str]:
    """Return IDS: hashes of the grid's poses, and of the true poses of an evaluation's touches with their sensor.

    Rows with the same `grid_id` have the same grid, random poses and mean error of a random pose.
    """
    pressed = {"sensor": localizer.scene.geometry.describe(), **touches.describe(localizer)}
    grid = {"poses": _hash_poses(localizer.model.grid.T_sensor_object), "seed": touches.seed}
    return dict(zip(IDS, map(hash_shortly, (grid, {"poses": _hash_poses(table["T_true"]), **pressed})), strict=True))


def _hash_poses(T: Poses) -> str:
    """Return a hash of poses (N, 4, 4), metres, rounded so that it is the same on every machine."""
    return hash_arrays(T=np.round(T, HASHED_DECIMALS) + 0.0)  # -0.0 becomes 0.0


def name_time(line: str) -> str:
    """Return the column of the time that the pose of a line needs."""
    stages = LINE_STAGES.get(line, SEARCHED)
    timed = next(name for name in TIMED_LINES if LINE_STAGES.get(name, SEARCHED) == stages)
    return f"{timed}_ms"


def _load(configs: Sequence[ObjectConfig]) -> dict[str, tuple[ObjectConfig, ObjectModel]]:
    """Return the objects by name. Raises ConfigError if two objects have the same name."""
    found: dict[str, tuple[ObjectConfig, ObjectModel]] = {}
    for config in configs:
        obj = load_object(config.path, config.units, config.symmetry)
        if obj.name in found:
            other = found[obj.name][0].path
            raise ConfigError(
                f"{other} and {config.path} are both called {obj.name}; rename one, or run them separately"
            )
        found[obj.name] = (config, obj)
    return found


@dataclass(frozen=True)
class CombinationJob:
    """A combination for a worker, evaluated on `count` touches."""

    key: str
    config: RunConfig
    count: int
    store: Path

    def measure(self, obj: ObjectModel, store: StageStore) -> dict[str, Any]:
        """Return the summary of the evaluation. Raises ConfigError if this machine has other software or files."""
        config = self.config
        if make_combination_key(config, obj, self.count, describe_components(config)) != self.key:
            raise ConfigError(
                "the worker's tactile-loc, plugins or sensor file differ from those of the machine that started the "
                "sweep; install the same versions there"
            )
        localizer = Localizer(config, obj, store)
        start_s = time.perf_counter()
        localizer.source.describe_scores()  # builds the grid and its shapes, and trains the encoder
        _ = localizer.source.temperature_scaling
        model_s = time.perf_counter() - start_s if store.built else 0.0
        touches = choose_touches(config)
        evaluation = evaluate(localizer, self.count, touches)
        return {**summarise(evaluation), **identify(localizer, touches, evaluation), "model_s": round(model_s, 3)}


def summarise(table: ExampleTable) -> dict[str, Any]:
    """Return ERRORS (mm, and shares of a random pose's mean error), COVERAGES, nll_nats and TIMES (medians, ms).

    `low` and `high` are the 95 % interval of a median. Numbers have six digits. A number that is not finite becomes
    None, such as the likelihood if a matcher did not score the true pose. TOUCHES has lists with a value for each
    touch: "LINE_mm" of LINES, "LINE_ms" of TIMED_LINES, and "refused".
    """
    values: dict[str, float] = {}
    touches: dict[str, list[Any]] = {}
    for row in summarise_lines(table, LINES):
        name, errors_mm = row["line"], 1e3 * table.errors_m(row["line"], "add")
        _, low_mm, high_mm = estimate_median(errors_mm[None])
        errors = (1e3 * row["median_m"], low_mm, high_mm, 1e3 * row["mean_m"], row["median_normalised"])
        values |= {f"{name}_{what}": error for what, error in zip(STATISTICS, errors, strict=True)}
        touches[f"{name}_mm"] = round_numbers(errors_mm)
    values |= dict(zip(COVERAGES, measure_coverage(table), strict=True)) | {"nll_nats": table["nll_nats"].mean()}
    times_ms = {stage: 1e3 * table[f"{stage}_s"] for stage in protocol.TIMED}
    values |= {f"{stage}_ms": np.median(some) for stage, some in times_ms.items()}
    for name in TIMED_LINES:
        needed_ms = np.sum([times_ms[stage] for stage in LINE_STAGES.get(name, SEARCHED)], axis=0)
        median = estimate_median(needed_ms[None])
        values |= dict(zip((f"{name}_ms", f"{name}_low_ms", f"{name}_high_ms"), median, strict=True))
        touches[f"{name}_ms"] = round_numbers(needed_ms)
    touches["refused"] = table["refused"].tolist()
    numbers = dict(zip(values, round_numbers(values.values()), strict=True))
    return {"grid_poses": int(table["grid_poses"][0]), **numbers, TOUCHES: touches}


def round_numbers(values: Iterable[float]) -> list[float | None]:
    """Return numbers with six digits, and None for those that are not finite."""
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]
