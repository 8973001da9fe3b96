"""The front door for plugin authors: all that a component and its package import, beside `tactile_loc.testing`.

Slots, their options, capabilities and results; what they are given; the errors they raise; and the helpers that the
built-in components are made with. Names are imported when they are first used, so that a package's `__init__` may
import `ComponentSpec` and `hookimpl` and stays light.
"""

# ruff: noqa: I001 - names stand with those that serve the same purpose

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_loc.core.lazy import lazy_names

if TYPE_CHECKING:
    # what a package says it offers, and for which version of this interface
    from tactile_loc.core.slots.interface import INTERFACE_VERSION as INTERFACE_VERSION
    from tactile_loc.core.slots.registry import ComponentSpec as ComponentSpec
    from tactile_loc.core.slots.registry import hookimpl as hookimpl
    from tactile_loc.core.slots.registry import registry as registry

    # the seven slots, what they declare, are given and return
    from tactile_loc.core.slots.refiner import Candidate as Candidate
    from tactile_loc.core.slots.component import Capabilities as Capabilities
    from tactile_loc.core.slots.encoder import Checkpoints as Checkpoints
    from tactile_loc.core.slots.component import Component as Component
    from tactile_loc.core.slots.component import ComponentOptions as ComponentOptions
    from tactile_loc.core.slots.encoder import Encoder as Encoder
    from tactile_loc.core.slots.component import Float32 as Float32
    from tactile_loc.core.slots.fuser import Fuser as Fuser
    from tactile_loc.core.slots.grid import GridSampler as GridSampler
    from tactile_loc.core.slots.matcher import ExactMatcher as ExactMatcher
    from tactile_loc.core.slots.matcher import Matcher as Matcher
    from tactile_loc.core.poses.priors import Prior as Prior
    from tactile_loc.core.slots.refiner import RefinedPose as RefinedPose
    from tactile_loc.core.slots.refiner import Refiner as Refiner
    from tactile_loc.core.slots.renderer import Renderer as Renderer
    from tactile_loc.core.slots.scene import Scene as Scene
    from tactile_loc.core.slots.sensor import SensorModel as SensorModel
    from tactile_loc.core.slots.encoder import TrainingBatch as TrainingBatch
    from tactile_loc.core.slots.encoder import TrainingProblem as TrainingProblem
    from tactile_loc.core.slots.encoder import TrainingTouches as TrainingTouches
    from tactile_loc.core.slots.scene import View as View
    from tactile_loc.core.objects.mesh import ObjectModel as ObjectModel
    from tactile_loc.core.objects.mesh import TriangleMesh as TriangleMesh
    from tactile_loc.core.poses.metric import PoseGrid as PoseGrid
    from tactile_loc.core.poses.metric import PoseMetric as PoseMetric
    from tactile_loc.core.geometry.rigid import Poses as Poses
    from tactile_loc.core.poses.posterior import PosePosterior as PosePosterior
    from tactile_loc.core.progress import Progress as Progress
    from tactile_loc.core.progress import rank as rank
    from tactile_loc.core.sensing.touch import ContactShape as ContactShape
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry as SensorGeometry
    from tactile_loc.core.sensing.sensor_geometry import Drawing as Drawing
    from tactile_loc.core.sensing.touch import Touch as Touch
    from tactile_loc.core.sensing.sensor_geometry import find_drawing as find_drawing
    from tactile_loc.core.objects.symmetry import SymmetryGroup as SymmetryGroup

    # errors that a component raises: each is one sentence for the user
    from tactile_loc.core.errors import ConfigError as ConfigError
    from tactile_loc.core.errors import GridError as GridError
    from tactile_loc.core.errors import MissingLibraryError as MissingLibraryError
    from tactile_loc.core.errors import RenderError as RenderError
    from tactile_loc.core.errors import SensorError as SensorError
    from tactile_loc.core.errors import TactileLocError as TactileLocError
    from tactile_loc.core.errors import TouchError as TouchError
    from tactile_loc.core.errors import TrainingError as TrainingError
    from tactile_loc.core.errors import WeightsError as WeightsError
    from tactile_loc.core.errors import did_you_mean as did_you_mean

    # rotations and transforms
    from tactile_loc.core.geometry.rigid import axis_times_sine as axis_times_sine
    from tactile_loc.core.geometry.rigid import move_covariance as move_covariance
    from tactile_loc.core.geometry.rigid import cross_matrix as cross_matrix
    from tactile_loc.core.geometry.rigid import align_to_z as align_to_z
    from tactile_loc.core.geometry.rigid import invert as invert
    from tactile_loc.core.geometry.rigid import is_rigid as is_rigid
    from tactile_loc.core.geometry.rigid import make_transform as make_transform
    from tactile_loc.core.geometry.rigid import quaternion_to_rotation as quaternion_to_rotation
    from tactile_loc.core.geometry.rigid import draw_rotations as draw_rotations
    from tactile_loc.core.geometry.rigid import rotation_about as rotation_about
    from tactile_loc.core.geometry.rigid import rotation_angle as rotation_angle
    from tactile_loc.core.geometry.rigid import rotation_to_quaternion as rotation_to_quaternion
    from tactile_loc.core.geometry.rigid import transform_points as transform_points
    from tactile_loc.core.geometry.rigid import make_translation as make_translation

    # for sensors and renderers
    from tactile_loc.core.objects.blocks import Blocks as Blocks
    from tactile_loc.core.objects.blocks import make_blocks as make_blocks
    from tactile_loc.core.compiled import run_in_threads as run_in_threads
    from tactile_loc.core.compiled import njit as njit
    from tactile_loc.core.sensing.contact import bring_to_contact as bring_to_contact
    from tactile_loc.core.sensing.contact import group_rotations as group_rotations
    from tactile_loc.core.slots.depth_sensor import DepthSensor as DepthSensor
    from tactile_loc.core.sensing.touch import compute_contact_depth as compute_contact_depth
    from tactile_loc.core.sensing.touch import contact_shape_from_array as contact_shape_from_array
    from tactile_loc.core.objects.blocks import NearestTriangles as NearestTriangles
    from tactile_loc.core.objects.surface_field import SurfaceField as SurfaceField
    from tactile_loc.core.objects.surface_field import find_closest_on_triangle as find_closest_on_triangle
    from tactile_loc.core.objects.surface_field import find_downhill as find_downhill
    from tactile_loc.core.objects.surface_field import build_surface_field as build_surface_field
    from tactile_loc.core.objects.surface_field import find_triangle_near as find_triangle_near
    from tactile_loc.core.sensing.zbuffer import draw_nearest_depths as draw_nearest_depths

    # for grids
    from tactile_loc.core.slots.all_rotations import AllRotationsGrid as AllRotationsGrid
    from tactile_loc.core.slots.all_rotations import find_centroid_range as find_centroid_range
    from tactile_loc.core.poses.lattices import compute_lattice_shape as compute_lattice_shape
    from tactile_loc.core.poses.lattices import make_plane_lattice as make_plane_lattice
    from tactile_loc.core.slots.all_rotations import draw_places as draw_places
    from tactile_loc.core.poses.lattices import find_reachable_translations as find_reachable_translations
    from tactile_loc.core.poses.lattices import require_spacing as require_spacing
    from tactile_loc.core.poses.lattices import make_shifted_lattice as make_shifted_lattice

    from tactile_loc.core.sensing.places import PATCH_PX as PATCH_PX
    from tactile_loc.core.sensing.places import PITCH_M as PITCH_M
    from tactile_loc.core.sensing.places import Places as Places
    from tactile_loc.core.sensing.places import make_patches as make_patches

    # for encoders that learn
    from tactile_loc.core.simulation.contact_poses import make_contact_grid as make_contact_grid
    from tactile_loc.core.simulation.contact_poses import draw_contact_poses as draw_contact_poses
    from tactile_loc.core.simulation.contact_poses import draw_contacts as draw_contacts
    from tactile_loc.core.simulation.noise import NoiseLevel as NoiseLevel
    from tactile_loc.core.simulation.noise import TouchNoise as TouchNoise
    from tactile_loc.core.simulation.noise import make_noise as make_noise

    # for refiners that register
    from tactile_loc.core.registration.joint_registration import JointRegistration as JointRegistration
    from tactile_loc.core.registration.joint_registration import RegistrationOptions as RegistrationOptions
    from tactile_loc.core.sensing.clouds import make_contact_cloud as make_contact_cloud
    from tactile_loc.core.registration.cloud_refiner import Cloud as Cloud
    from tactile_loc.core.registration.cloud_refiner import CloudRefiner as CloudRefiner
    from tactile_loc.core.registration.cloud_refiner import Registration as Registration
    from tactile_loc.core.registration.cloud_refiner import make_orthonormal as make_orthonormal

    # for fusers
    from tactile_loc.core.slots.common_poses import CommonPosesFuser as CommonPosesFuser
    from tactile_loc.core.slots.common_poses import require_fusable as require_fusable
    from tactile_loc.core.slots.common_poses import find_common_poses as find_common_poses
    from tactile_loc.core.slots.common_poses import compute_prior_weights as compute_prior_weights

__all__, __getattr__, __dir__ = lazy_names(__name__)
