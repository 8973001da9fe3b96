"""`tactile-loc build`: an object's model, ahead of time."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from tactile_loc_cli import options
from tactile_loc_cli.console import say

if TYPE_CHECKING:
    from tactile_loc.core.poses.metric import PoseGrid
    from tactile_loc.locate.localizer import Localizer

MOST_MEASURED = 2000  # poses whose distance to their neighbours is measured


def build(
    object: options.Object = None,
    units: options.MeshUnits = None,
    symmetry: options.Symmetry = None,
    press_depth: options.PressDepth = None,
    sensor: options.Sensor = None,
    grid: options.Grid = None,
    renderer: options.Renderer = None,
    encoder: options.Encoder = None,
    option: options.SetOption = None,
    config: options.Config = None,
    seed: options.Seed = None,
    store: options.Store = None,
) -> dict[str, Any]:
    """Build an object's model ahead of time.

    That is what `run` does by itself at first; stages that are in the store already are reused.
    """
    settings = options.run_config(
        options.RunOptions(
            object=object, units=units, symmetry=symmetry, press_depth=press_depth, sensor=sensor, grid=grid,
            renderer=renderer, encoder=encoder, option=option, config=config, seed=seed,
        )
    )  # fmt: skip
    localizer = options.open_localizer(settings, store)
    start = time.perf_counter()
    press_m = _press_depth_m(localizer)
    if localizer.search is None:
        localizer.listed.matcher(press_m)
    _ = localizer.source.trained  # learned now, not at the first touch
    _ = localizer.probabilities.temperature_scaling  # and fitted
    return _report(localizer, time.perf_counter() - start)


def _press_depth_m(localizer: Localizer) -> float:
    """The press depth to build for. Raises TouchError when the sensor cannot resolve it."""
    from tactile_loc.core.errors import TouchError

    deepest_m = localizer.scene.geometry.max_depth_m
    asked_m = options.press_depth_m(localizer.config)
    if asked_m is not None and not 0 < asked_m <= deepest_m:
        raise TouchError(
            f"a press of {1e3 * asked_m:g} mm is outside the sensor's range of 0 to {1e3 * deepest_m:g} mm"
        )
    return deepest_m if asked_m is None else asked_m


def _report(localizer: Localizer, seconds: float) -> dict[str, Any]:
    obj, store = localizer.object, localizer.store
    extents_m, stages = obj.mesh.extents_m.tolist(), _stages(localizer)
    size = " x ".join(f"{1e3 * extent_m:.3g}" for extent_m in extents_m)
    say(f"object: {obj.name}, {size} mm, {len(obj.mesh.faces)} triangles, symmetry {obj.symmetry}")
    grid = _grid(localizer)
    for stage, became in stages.items():
        say(f"{stage}: {became}")
    say(f"stored in {store.root} ({seconds:.1f} s)")
    about = {"size_m": extents_m, "triangles": len(obj.mesh.faces), "symmetry": str(obj.symmetry)}
    return {
        "object": {"name": obj.name, "source": obj.source, **about},
        "grid": grid,
        "stages": stages, "store": str(store.root), "seconds": seconds,
    }  # fmt: skip


def _grid(localizer: Localizer) -> dict[str, Any]:
    """Say what is searched, and return it."""
    if localizer.search is not None:
        places, turns = len(localizer.search.places), len(localizer.search.yaws_rad)
        say(f"grid: {places} places of the whole object, each turned {turns} times")
        return {"places": places, "turns": turns}
    grid = localizer.model.grid
    spacing_m = _spacing_m(grid)
    apart = "" if spacing_m is None else f", {1e3 * spacing_m:.2f} mm apart on average"
    say(f"grid: {len(grid)} poses{apart}")
    return {"poses": len(grid), "mean_spacing_m": spacing_m}


def _stages(localizer: Localizer) -> dict[str, str]:
    """Whether each stage was built or reused."""
    built = [key.stage for key in localizer.store.built]
    learned = ("encoder",) if localizer.encoder.capabilities.needs_training else ()
    fitted = ("temperature",) if localizer.config.temperature is None else ()
    model = ("grid", "shapes", *learned, "bank") if localizer.search is None else ("places", *learned)
    return {stage: "built" if stage in built else "reused" for stage in (*model, *fitted)}


def _spacing_m(grid: PoseGrid) -> float | None:
    """The mean distance between neighbouring poses, metres; of a large grid, that of some, of a single pose none."""
    import numpy as np

    if len(grid) < 2:
        return None
    some = np.arange(0, len(grid), max(1, len(grid) // MOST_MEASURED))
    return float(grid.neighbour_spacing(some).mean())
