"""What the built-in components and the annexes share: geometry, base classes and compiled loops.

No component needs these names. They save work, and `tactile_loc.plugin` has the interfaces. Names are imported at their
first use.
"""

# ruff: noqa: I001 - names are grouped by purpose

from typing import TYPE_CHECKING

from tactile_loc.core.runtime.lazy import lazy_names

if TYPE_CHECKING:
    # for packages that define kinds of components beside the slots
    from tactile_loc.slots.component import Component as Component
    from tactile_loc.slots.interface import INTERFACE_VERSION as INTERFACE_VERSION
    from tactile_loc.slots.registry import ComponentKind as ComponentKind

    # base classes of a slot's components
    from tactile_loc.bases.all_rotations import AllRotationsGrid as AllRotationsGrid
    from tactile_loc.bases.cloud_refiner import Cloud as Cloud, CloudRefiner as CloudRefiner
    from tactile_loc.bases.cloud_refiner import Registration as Registration, make_orthonormal as make_orthonormal
    from tactile_loc.bases.common_poses import CommonPosesFuser as CommonPosesFuser
    from tactile_loc.bases.common_poses import require_sensor_poses as require_sensor_poses
    from tactile_loc.bases.depth_sensor import DepthSensor as DepthSensor, GelOptions as GelOptions
    from tactile_loc.bases.exact_matcher import ExactMatcher as ExactMatcher

    # rotations and transforms
    from tactile_loc.core.geometry.pose_words import name_direction as name_direction, name_line as name_line
    from tactile_loc.core.geometry.lie import exponential as exponential, logarithm as logarithm
    from tactile_loc.core.geometry.rigid import align_to_z as align_to_z, axis_angle as axis_angle
    from tactile_loc.core.geometry.rigid import draw_rotations as draw_rotations
    from tactile_loc.core.geometry.rigid import invert as invert, is_rigid as is_rigid
    from tactile_loc.core.geometry.rigid import make_transform as make_transform, make_translation as make_translation
    from tactile_loc.core.geometry.rigid import quaternion_to_rotation as quaternion_to_rotation
    from tactile_loc.core.geometry.rigid import rotation_about as rotation_about, rotation_angle as rotation_angle
    from tactile_loc.core.geometry.rigid import rotation_to_quaternion as rotation_to_quaternion
    from tactile_loc.core.geometry.rigid import transform_points as transform_points

    # poses, and orders that rounding cannot change
    from tactile_loc.core.objects.symmetry import SymmetryGroup as SymmetryGroup
    from tactile_loc.core.poses.merging import merge_modes as merge_modes
    from tactile_loc.core.poses.metric import PoseMetric as PoseMetric
    from tactile_loc.core.poses.posterior import group_ties as group_ties, rank_poses as rank_poses

    # sensors and renderers
    from tactile_loc.core.objects.surface_field import SurfaceField as SurfaceField
    from tactile_loc.core.sensing.contact import bring_to_contact as bring_to_contact
    from tactile_loc.core.sensing.contact import group_rotations as group_rotations
    from tactile_loc.core.sensing.touch import contact_shape_from_array as contact_shape_from_array
    from tactile_loc.core.sensing.zbuffer import draw_nearest_depths as draw_nearest_depths

    # grids
    from tactile_loc.bases.all_rotations import draw_places as draw_places
    from tactile_loc.core.poses.lattices import compute_lattice_shape as compute_lattice_shape
    from tactile_loc.core.poses.lattices import find_reachable_translations as find_reachable_translations
    from tactile_loc.core.poses.lattices import make_shifted_lattice as make_shifted_lattice
    from tactile_loc.core.poses.lattices import require_spacing as require_spacing

    # places, and searches among them
    from tactile_loc.core.places.places import PATCH_PX as PATCH_PX, PITCH_M as PITCH_M
    from tactile_loc.core.places.places import average_patches as average_patches, cut_patches as cut_patches
    from tactile_loc.core.places.places import make_patches as make_patches
    from tactile_loc.core.places.rotated_patches import TouchBounds as TouchBounds, bound_touch as bound_touch
    from tactile_loc.core.places.rotated_patches import find_anchor as find_anchor, rotate_patches as rotate_patches
    from tactile_loc.core.sensing.scene import compute_full_evidence as compute_full_evidence

    # encoders that learn
    from tactile_loc.core.sensing.noise import NoiseLevel as NoiseLevel, make_noise as make_noise
    from tactile_loc.simulate.contact_poses import draw_contact_poses as draw_contact_poses
    from tactile_loc.simulate.contact_poses import make_contact_grid as make_contact_grid

    # refiners
    from tactile_loc.core.registration.joint_registration import JointRegistration as JointRegistration
    from tactile_loc.core.registration.joint_registration import RegistrationOptions as RegistrationOptions
    from tactile_loc.core.sensing.clouds import make_contact_cloud as make_contact_cloud
    from tactile_loc.core.sensing.clouds import spread_points as spread_points

    # compiled loops, threads, memory and messages
    from tactile_loc.core.runtime.caches import ByteCache as ByteCache
    from tactile_loc.core.runtime.compiled import map_in_threads as map_in_threads, njit as njit
    from tactile_loc.core.runtime.compiled import run_in_threads as run_in_threads
    from tactile_loc.core.runtime.compiled import use_one_blas_thread as use_one_blas_thread
    from tactile_loc.core.runtime.errors import did_you_mean as did_you_mean
    from tactile_loc.core.runtime.formatting import show_name as show_name

__all__, __getattr__, __dir__ = lazy_names(__name__)
