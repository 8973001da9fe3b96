"""Deprecated names. They work until version REMOVAL, with a warning.

`RENAMED` lists the old names in modules. The class decorator `keep_old_names` lists the old names of a class's members.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

REMOVAL = "0.3"

PASSED_OVER = {__name__, "tactile_loc.core.runtime.lazy", "importlib._bootstrap"}

Kind = TypeVar("Kind", bound=type)

_RIGID = {
    "translation": "make_translation",
    "covariance_at": "move_covariance",
    "covariance_along": "rotate_covariance",
    "random_rotations": "draw_rotations",
}
_LATTICES = {
    "lattice_shape": "compute_lattice_shape",
    "plane_lattice": "make_plane_lattice",
    "shifted_lattice": "make_shifted_lattice",
    "reachable_translations": "find_reachable_translations",
}
_ALL_ROTATIONS = {"centroid_range": "find_centroid_range", "random_places": "draw_places"}
_COMMON_POSES = {"prior_weights": "compute_prior_weights", "common_poses": "find_common_poses"}
_CLOUD_REFINER = {"orthonormal": "make_orthonormal"}
_NEXT_TOUCH = {"next_touch": "choose_next_touch"}
_IMAGES = {"image_array": "decode_image"}
_NOISE = {"noise_level": "make_noise"}

# for each module, its old names and the new names
RENAMED: dict[str, dict[str, str]] = {
    "tactile_loc": {**_NOISE, **_NEXT_TOUCH, **_IMAGES},
    "tactile_loc.plugin": {
        **{old: new for old, new in _RIGID.items() if old != "covariance_along"},
        **_LATTICES, **_ALL_ROTATIONS, **_COMMON_POSES, **_CLOUD_REFINER, **_NOISE,
        "in_threads": "run_in_threads",
        "blocks_of": "make_blocks",
        "surface_field": "build_surface_field",
        "triangle_near": "find_triangle_near",
        "downhill": "find_downhill",
        "closest_on_triangle": "find_closest_on_triangle",
        "contact_cloud": "make_contact_cloud",
        "as_patches": "make_patches",
        "as_drawn": "find_drawing",
        "contact_depth": "compute_contact_depth",
        "nearest_depths": "draw_nearest_depths",
        "contact_grid": "make_contact_grid",
        "random_contact_poses": "draw_contact_poses",
        "random_contacts": "draw_contacts",
    },
    "tactile_loc.core.runtime.errors": {"quoted": "quote", "named": "name_source", "one_line": "fold_line"},
    "tactile_loc.core.geometry.rigid": _RIGID,
    "tactile_loc.core.poses.lattices": _LATTICES,
    "tactile_loc.core.poses.priors": {"tempered": "temper", "touches_behind": "count_touches"},
    "tactile_loc.bases.cloud_refiner": _CLOUD_REFINER,
    "tactile_loc.bases.all_rotations": _ALL_ROTATIONS,
    "tactile_loc.bases.common_poses": _COMMON_POSES,
    "tactile_loc.io.streams.ros_messages": _IMAGES,
    "tactile_loc.planning.next_touch": _NEXT_TOUCH,
    "tactile_loc.testing": {"checks_for": "list_checks", "properties_for": "list_properties"},
    "tactile_loc.testing.problems": {
        "box": "make_box",
        "cylinder": "make_cylinder",
        "moved": "move_mesh",
        "transformed": "transform_mesh",
        "mirrored": "mirror_mesh",
        "copied": "copy_mesh",
        "scaled": "scale_mesh",
        "joined": "join_meshes",
        "stepped_block": "make_stepped_block",
        "ball": "make_ball",
        "plate": "make_plate",
        "overhang": "make_overhang",
        "block": "make_block",
        "plain_object": "make_plain_object",
        "prism": "make_prism",
        "mirrored_block": "make_mirrored_block",
        "rod": "make_rod",
        "larger": "scale_sensor",
        "block_scene": "make_block_scene",
        "pressed_block": "press_block",
        "pressed_prism": "press_prism",
        "planar_pose": "make_planar_pose",
        "touch_at": "make_touch",
        "with_depth": "replace_depth",
        "contact_poses": "make_contact_poses",
        "small_grid": "make_small_grid",
        "training_problem": "make_training_problem",
        "place_training_problem": "make_place_training_problem",
    },
}  # fmt: skip


def find_renamed(module: str, name: str) -> Any:
    """Return a module's attribute by its old name, and warn. Raises AttributeError if the name is unknown."""
    new = RENAMED.get(module, {}).get(name)
    if new is None:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    _warn(f"{module}.{name}", f"{module}.{new}")
    return getattr(sys.modules[module], new)


def make_getattr(module: str) -> Callable[[str], Any]:
    """Return the `__getattr__` of a module of RENAMED, which finds old names."""
    return lambda name: find_renamed(module, name)


def keep_old_names(**renamed: str) -> Callable[[Kind], Kind]:
    """Return a class decorator that keeps old names of methods and attributes, given as `old="new"`, with a warning."""

    def decorate(kind: Kind) -> Kind:
        for old, new in renamed.items():
            setattr(kind, old, _make_alias(kind.__name__, old, new))
        return kind

    return decorate


def _make_alias(kind: str, old: str, new: str) -> property:
    def find(self: Any) -> Any:
        _warn(f"{kind}.{old}", f"{kind}.{new}")
        return getattr(self, new)

    return property(find, doc=f"The old name of `{new}`, which goes in version {REMOVAL}.")


def _warn(old: str, new: str) -> None:
    """Warn about the line that uses the old name. This line is in the first frame outside the modules PASSED_OVER."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals.get("__name__") in PASSED_OVER:
        frame, level = frame.f_back, level + 1
    text = f"{old} is now {new}; the old name will be removed in tactile-loc {REMOVAL}"
    warnings.warn(text, DeprecationWarning, stacklevel=level)
