"""The interface for plugin authors. A component imports only this module, and its tests `tactile_loc.testing`.

The module offers the slots with their options, capabilities, arguments and results. It also offers the errors that
components raise, and the helpers of the built-in components. Names are imported at their first use, so a package's
`__init__` can import `ComponentSpec` and `hookimpl` quickly.
"""

# ruff: noqa: I001 - names are grouped by purpose

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_loc.core.runtime.lazy import lazy_names

if TYPE_CHECKING:
    # what a package offers, and for which version of this interface
    from tactile_loc.slots.interface import INTERFACE_VERSION as INTERFACE_VERSION
    from tactile_loc.slots.registry import CommandSpec as CommandSpec, ComponentKind as ComponentKind
    from tactile_loc.slots.registry import ComponentSpec as ComponentSpec
    from tactile_loc.slots.registry import hookimpl as hookimpl
    from tactile_loc.slots.registry import registry as registry

    # the seven slots, with their capabilities, arguments and results
    from tactile_loc.core.poses.candidate import Candidate as Candidate, RefinedPose as RefinedPose
    from tactile_loc.slots.refiner import Refiner as Refiner
    from tactile_loc.slots.component import Capabilities as Capabilities, Component as Component
    from tactile_loc.core.geometry.rigid import Float32 as Float32
    from tactile_loc.core.runtime.options import ComponentOptions as ComponentOptions
    from tactile_loc.slots.encoder import Checkpoints as Checkpoints, Encoder as Encoder
    from tactile_loc.slots.encoder import TrainingBatch as TrainingBatch, TrainingProblem as TrainingProblem
    from tactile_loc.slots.encoder import TrainingTouches as TrainingTouches
    from tactile_loc.slots.fuser import Fuser as Fuser
    from tactile_loc.slots.grid import GridSampler as GridSampler
    from tactile_loc.bases.exact_matcher import ExactMatcher as ExactMatcher
    from tactile_loc.slots.matcher import Matcher as Matcher
    from tactile_loc.core.poses.priors import Prior as Prior
    from tactile_loc.slots.renderer import Renderer as Renderer
    from tactile_loc.core.sensing.scene import Scene as Scene, View as View
    from tactile_loc.slots.sensor import DepthFiles as DepthFiles, SensorModel as SensorModel
    from tactile_loc.core.objects.mesh import ObjectModel as ObjectModel, TriangleMesh as TriangleMesh
    from tactile_loc.core.poses.metric import PoseGrid as PoseGrid, PoseMetric as PoseMetric
    from tactile_loc.core.geometry.rigid import Poses as Poses
    from tactile_loc.core.poses.posterior import NoPoseLeft as NoPoseLeft, PosePosterior as PosePosterior
    from tactile_loc.core.runtime.progress import Progress as Progress, rank as rank
    from tactile_loc.core.sensing.touch import ContactShape as ContactShape, Touch as Touch
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry as SensorGeometry, Drawing as Drawing
    from tactile_loc.core.sensing.sensor_geometry import find_drawing as find_drawing
    from tactile_loc.core.objects.symmetry import SymmetryGroup as SymmetryGroup

    # errors that a component raises, each with a short message for the user
    from tactile_loc.core.runtime.errors import AnswerError as AnswerError
    from tactile_loc.core.runtime.errors import ConfigError as ConfigError, GridError as GridError
    from tactile_loc.core.runtime.errors import MissingLibraryError as MissingLibraryError, RenderError as RenderError
    from tactile_loc.core.runtime.errors import SensorError as SensorError, TactileLocError as TactileLocError
    from tactile_loc.core.runtime.errors import TouchError as TouchError, TrainingError as TrainingError
    from tactile_loc.core.runtime.errors import WeightsError as WeightsError, did_you_mean as did_you_mean

    # rotations and transforms
    from tactile_loc.core.geometry.rigid import cross_matrix as cross_matrix, align_to_z as align_to_z, invert as invert
    from tactile_loc.core.geometry.rigid import is_rigid as is_rigid, make_transform as make_transform
    from tactile_loc.core.geometry.rigid import quaternion_to_rotation as quaternion_to_rotation
    from tactile_loc.core.geometry.rigid import draw_rotations as draw_rotations, rotation_about as rotation_about
    from tactile_loc.core.geometry.rigid import rotation_angle as rotation_angle
    from tactile_loc.core.geometry.rigid import rotation_to_quaternion as rotation_to_quaternion
    from tactile_loc.core.geometry.rigid import transform_points as transform_points
    from tactile_loc.core.geometry.rigid import make_translation as make_translation

    from tactile_loc.core.geometry.lie import exponential as exponential

    # for sensors and renderers
    from tactile_loc.core.runtime.compiled import run_in_threads as run_in_threads, njit as njit
    from tactile_loc.core.sensing.contact import bring_to_contact as bring_to_contact
    from tactile_loc.core.sensing.contact import group_rotations as group_rotations
    from tactile_loc.bases.depth_sensor import DepthSensor as DepthSensor
    from tactile_loc.bases.depth_sensor import GelOptions as GelOptions
    from tactile_loc.core.sensing.touch import compute_contact_depth as compute_contact_depth
    from tactile_loc.core.sensing.touch import contact_shape_from_array as contact_shape_from_array
    from tactile_loc.core.objects.surface_field import SurfaceField as SurfaceField
    from tactile_loc.core.sensing.zbuffer import draw_nearest_depths as draw_nearest_depths

    # for grids
    from tactile_loc.bases.all_rotations import AllRotationsGrid as AllRotationsGrid
    from tactile_loc.bases.all_rotations import find_centroid_range as find_centroid_range
    from tactile_loc.bases.all_rotations import draw_places as draw_places
    from tactile_loc.core.poses.lattices import compute_lattice_shape as compute_lattice_shape
    from tactile_loc.core.poses.lattices import make_plane_lattice as make_plane_lattice
    from tactile_loc.core.poses.lattices import find_reachable_translations as find_reachable_translations
    from tactile_loc.core.poses.lattices import require_spacing as require_spacing
    from tactile_loc.core.poses.lattices import make_shifted_lattice as make_shifted_lattice

    # for searches among places of many objects
    from tactile_loc.core.places.rotated_patches import find_anchor as find_anchor, rotate_patches as rotate_patches
    from tactile_loc.core.sensing.scene import compute_full_evidence as compute_full_evidence
    from tactile_loc.core.runtime.compiled import use_one_blas_thread as use_one_blas_thread
    from tactile_loc.core.runtime.caches import ByteCache as ByteCache
    from tactile_loc.core.runtime.compiled import map_in_threads as map_in_threads
    from tactile_loc.core.runtime.formatting import show_name as show_name
    from tactile_loc.core.places.rotated_patches import TouchBounds as TouchBounds, bound_touch as bound_touch

    from tactile_loc.core.places.places import PATCH_PX as PATCH_PX, PITCH_M as PITCH_M, Places as Places
    from tactile_loc.core.places.places import make_patches as make_patches

    # for encoders
    from tactile_loc.core.places.places import average_patches as average_patches
    from tactile_loc.core.places.places import cut_patches as cut_patches

    # for encoders that learn
    from tactile_loc.simulate.contact_poses import make_contact_grid as make_contact_grid
    from tactile_loc.simulate.contact_poses import draw_contact_poses as draw_contact_poses
    from tactile_loc.simulate.contact_poses import draw_contacts as draw_contacts
    from tactile_loc.core.sensing.noise import NoiseLevel as NoiseLevel, TouchNoise as TouchNoise
    from tactile_loc.core.sensing.noise import make_noise as make_noise

    # for refiners that register
    from tactile_loc.core.registration.joint_registration import JointRegistration as JointRegistration
    from tactile_loc.core.registration.joint_registration import RegistrationOptions as RegistrationOptions
    from tactile_loc.core.sensing.clouds import make_contact_cloud as make_contact_cloud
    from tactile_loc.bases.cloud_refiner import Cloud as Cloud, CloudRefiner as CloudRefiner
    from tactile_loc.bases.cloud_refiner import Registration as Registration
    from tactile_loc.bases.cloud_refiner import make_orthonormal as make_orthonormal

    # for lists of poses, in orders that rounding cannot change
    from tactile_loc.core.poses.merging import merge_modes as merge_modes
    from tactile_loc.core.poses.posterior import group_ties as group_ties, rank_poses as rank_poses

    # for fusers
    from tactile_loc.bases.common_poses import CommonPosesFuser as CommonPosesFuser
    from tactile_loc.bases.common_poses import require_sensor_poses as require_sensor_poses

__all__, __getattr__, __dir__ = lazy_names(__name__)
