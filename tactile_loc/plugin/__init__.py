"""The interface for plugin authors: all that a component of the seven slots needs. Its tests use `tactile_loc.testing`.

The module offers the slots with their options, capabilities, arguments and results, and the errors that components
raise. `tactile_loc.plugin.helpers` has the geometry and the base classes that the built-in components use. Names are
imported at their first use, so a package's `__init__` can import `ComponentSpec` and `hookimpl` quickly.
"""

# ruff: noqa: I001 - names are grouped by purpose

from typing import TYPE_CHECKING

from tactile_loc.core.runtime.lazy import lazy_names

if TYPE_CHECKING:
    # what a package offers
    from tactile_loc.slots.registry import CommandSpec as CommandSpec, ComponentSpec as ComponentSpec
    from tactile_loc.slots.registry import hookimpl as hookimpl, registry as registry

    # the seven slots, and what their components declare
    from tactile_loc.slots.encoder import Encoder as Encoder
    from tactile_loc.slots.fuser import Fuser as Fuser
    from tactile_loc.slots.grid import GridSampler as GridSampler
    from tactile_loc.slots.matcher import Matcher as Matcher
    from tactile_loc.slots.refiner import Refiner as Refiner
    from tactile_loc.slots.renderer import Renderer as Renderer
    from tactile_loc.slots.sensor import DepthFiles as DepthFiles, SensorModel as SensorModel
    from tactile_loc.slots.component import Capabilities as Capabilities
    from tactile_loc.core.runtime.options import ComponentOptions as ComponentOptions

    # the arguments and results of their methods
    from tactile_loc.core.geometry.rigid import Float32 as Float32, Poses as Poses
    from tactile_loc.core.objects.mesh import ObjectModel as ObjectModel, TriangleMesh as TriangleMesh
    from tactile_loc.core.places.places import Places as Places
    from tactile_loc.core.poses.candidate import Candidate as Candidate, RefinedPose as RefinedPose
    from tactile_loc.core.poses.metric import PoseGrid as PoseGrid
    from tactile_loc.core.poses.posterior import NoPoseLeft as NoPoseLeft, PosePosterior as PosePosterior
    from tactile_loc.core.poses.priors import Prior as Prior
    from tactile_loc.core.runtime.progress import Progress as Progress
    from tactile_loc.core.sensing.gel import Gel as Gel
    from tactile_loc.core.sensing.scene import Scene as Scene, View as View
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry as SensorGeometry
    from tactile_loc.core.sensing.touch import ContactShape as ContactShape, Touch as Touch
    from tactile_loc.slots.encoder import TrainingBatch as TrainingBatch, TrainingProblem as TrainingProblem
    from tactile_loc.slots.encoder import TrainingTouches as TrainingTouches

    # errors that a component raises, each with a short message for the user
    from tactile_loc.core.runtime.errors import ConfigError as ConfigError, GridError as GridError
    from tactile_loc.core.runtime.errors import MissingLibraryError as MissingLibraryError, RenderError as RenderError
    from tactile_loc.core.runtime.errors import SensorError as SensorError, TactileLocError as TactileLocError
    from tactile_loc.core.runtime.errors import TouchError as TouchError, TrainingError as TrainingError
    from tactile_loc.core.runtime.errors import WeightsError as WeightsError

__all__, __getattr__, __dir__ = lazy_names(__name__)
