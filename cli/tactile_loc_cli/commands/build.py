"""`tactile-loc build`: do all that the first call would do ahead of time."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc_cli import options
from tactile_loc_cli.console import say
from tactile_loc_cli.options import RunOptions

if TYPE_CHECKING:
    from tactile_loc.locate.localizer import Localizer


BUILT = ("grid", "renderer", "encoder", "refiner", "fuser")  # the slots on which a model depends
Given = Annotated[
    RunOptions,
    options.Takes(
        *options.OBJECT,
        "press_depth",
        "sensor",
        *BUILT,
        *options.SETTINGS,
        "seed",
        press_depth="Press depth in mm for which the model is built. Default: the sensor's maximal depth.",
    ),
]


def build(given: Given, store: options.Store = None) -> dict[str, Any]:
    """Build an object's model ahead of time, and compile what its touches need.

    Without this command, the first `run` does this. Stages in the store are reused.
    """
    settings = options.make_config(given)
    localizer = options.open_localizer(settings, store)
    start = time.perf_counter()
    build_model(localizer, _require_press_depth_m(localizer))
    localizer.prepare()
    return _report(localizer, time.perf_counter() - start)


def build_model(localizer: Localizer, press_depth_m: float) -> None:
    """Build the stages for a touch of this press depth, in metres, or load the stages from the store."""
    localizer.source.prepare(press_depth_m)
    _ = localizer.source.temperature_scaling  # is fitted for some encoders


def _require_press_depth_m(localizer: Localizer) -> float:
    """Return the press depth, in metres, of the model to build. Raises TouchError if the sensor cannot resolve it."""
    deepest_m = localizer.scene.geometry.max_depth_m
    asked_m = localizer.config.touch.press_depth_m
    if asked_m is not None and not 0 < asked_m <= deepest_m:
        raise TouchError(
            f"the press depth cannot be {1e3 * asked_m:.3g} mm on this sensor; give more than 0 and at most "
            f"{1e3 * deepest_m:.3g} mm"
        )
    return deepest_m if asked_m is None else asked_m


def _report(localizer: Localizer, seconds: float) -> dict[str, Any]:
    obj, store = localizer.object, localizer.store
    from tactile_loc.store.keys import MEANINGS

    extents_m, stages = obj.mesh.extents_m.tolist(), _list_stages(localizer)
    size = " x ".join(f"{1e3 * extent_m:.3g}" for extent_m in extents_m)
    say(f"object: {obj.name}, {size} mm, {len(obj.mesh.faces)} triangles, symmetry {obj.symmetry}")
    grid = _describe_grid(localizer)
    for stage, origin in stages.items():
        say(f"{stage} ({MEANINGS[stage]}): {origin}")
    say(f"stored in {store.root} ({seconds:.1f} s)")
    about = {"size_m": extents_m, "triangles": len(obj.mesh.faces), "symmetry": str(obj.symmetry)}
    return {
        "object": {"name": obj.name, "source": obj.source, **about},
        "grid": grid,
        "stages": stages,
        "store": str(store.root),
        "seconds": seconds,
    }


def _describe_grid(localizer: Localizer) -> dict[str, Any]:
    """Print and return the number of poses to search."""
    counted = localizer.source.count_poses()
    if "places" in counted:
        say(f"grid: {counted['places']} places of the whole object, each in {counted['turns']} rotations")
    else:
        spacing_m = counted["mean_spacing_m"]
        apart = "" if spacing_m is None else f", {1e3 * spacing_m:.2f} mm apart on average"
        say(f"grid: {counted['poses']} poses{apart}")
    return counted


def _list_stages(localizer: Localizer) -> dict[str, str]:
    """Return "built" or "reused" for each stage."""
    built = [key.stage for key in localizer.store.built]
    return {stage: "built" if stage in built else "reused" for stage in localizer.source.stages}
