"""Locate known objects from touch.

This is the public API. Names are imported at their first use, so `import tactile_loc` is fast.
"""

from typing import TYPE_CHECKING

from tactile_loc.core.runtime.lazy import lazy_names

if TYPE_CHECKING:
    from tactile_loc.core.geometry.frame_tree import FrameTree as FrameTree
    from tactile_loc.core.objects.mesh import ObjectModel as ObjectModel
    from tactile_loc.core.objects.mesh import TriangleMesh as TriangleMesh
    from tactile_loc.core.poses.metric import PoseGrid as PoseGrid
    from tactile_loc.core.poses.metric import PoseMetric as PoseMetric
    from tactile_loc.core.poses.posterior import Mode as Mode
    from tactile_loc.core.poses.posterior import PosePosterior as PosePosterior
    from tactile_loc.core.poses.priors import GaussianPrior as GaussianPrior
    from tactile_loc.core.poses.priors import HypothesesPrior as HypothesesPrior
    from tactile_loc.core.poses.priors import PosteriorPrior as PosteriorPrior
    from tactile_loc.core.poses.priors import RegionPrior as RegionPrior
    from tactile_loc.core.poses.tolerance import Tolerance as Tolerance
    from tactile_loc.core.runtime.errors import NoContactError as NoContactError
    from tactile_loc.core.runtime.errors import TactileLocError as TactileLocError
    from tactile_loc.core.sensing.depth_maps import DepthKind as DepthKind
    from tactile_loc.core.sensing.depth_maps import DepthUnit as DepthUnit
    from tactile_loc.core.sensing.noise import make_noise as make_noise
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry as SensorGeometry
    from tactile_loc.core.sensing.touch import ContactShape as ContactShape
    from tactile_loc.core.sensing.touch import Touch as Touch
    from tactile_loc.data import DEMO_OBJECTS as DEMO_OBJECTS
    from tactile_loc.evaluation.jobs import QueuedJob as QueuedJob
    from tactile_loc.evaluation.jobs import resume_jobs as resume_jobs
    from tactile_loc.evaluation.metrics import PoseJudge as PoseJudge
    from tactile_loc.evaluation.robot_touches import RobotTouches as RobotTouches
    from tactile_loc.evaluation.summary import ExampleSummary as ExampleSummary
    from tactile_loc.evaluation.sweep.plan import Plan as Plan
    from tactile_loc.evaluation.sweep.sweep import run_sweep as run_sweep
    from tactile_loc.evaluation.sweep.tables import write_sweep as write_sweep
    from tactile_loc.evaluation.table import ExampleTable as ExampleTable
    from tactile_loc.evaluation.text_tables import format_markdown as format_markdown
    from tactile_loc.evaluation.text_tables import write_texts as write_texts
    from tactile_loc.evaluation.workers import LocalWorkers as LocalWorkers
    from tactile_loc.io.approach_files import Approach as Approach
    from tactile_loc.io.approach_files import read_approaches as read_approaches
    from tactile_loc.io.config import RunConfig as RunConfig
    from tactile_loc.io.images import IMAGE_SUFFIXES as IMAGE_SUFFIXES
    from tactile_loc.io.images import read_photo as read_photo
    from tactile_loc.io.listed_poses import read_detections as read_detections
    from tactile_loc.io.listed_poses import read_listed_poses as read_listed_poses
    from tactile_loc.io.meshes.mesh_files import Units as Units
    from tactile_loc.io.meshes.mesh_files import load_object as load_object
    from tactile_loc.io.meshes.mesh_files import simplify_mesh as simplify_mesh
    from tactile_loc.io.options import HypothesisOptions as HypothesisOptions
    from tactile_loc.io.options import SearchOptions as SearchOptions
    from tactile_loc.io.options import TrackerOptions as TrackerOptions
    from tactile_loc.io.sensor_files import write_sensor_file as write_sensor_file
    from tactile_loc.io.shape_pictures import paint_shape as paint_shape
    from tactile_loc.io.streams.frame_sources import Camera as Camera
    from tactile_loc.io.streams.frame_sources import FrameSource as FrameSource
    from tactile_loc.io.streams.frame_sources import ImageFolder as ImageFolder
    from tactile_loc.io.streams.frame_sources import SourceFrame as SourceFrame
    from tactile_loc.io.streams.frame_sources import open_source as open_source
    from tactile_loc.io.streams.recordings import Recording as Recording
    from tactile_loc.io.streams.recordings import choose_image_topic as choose_image_topic
    from tactile_loc.io.streams.ros_messages import RosPose as RosPose
    from tactile_loc.io.streams.ros_messages import decode_image as decode_image
    from tactile_loc.io.streams.sensor_tracks import SensorTrack as SensorTrack
    from tactile_loc.io.streams.sensor_tracks import read_sensor_track as read_sensor_track
    from tactile_loc.io.streams.videos import VIDEO_SUFFIXES as VIDEO_SUFFIXES
    from tactile_loc.io.touches import read_touch as read_touch
    from tactile_loc.io.touches import touch_from_image as touch_from_image
    from tactile_loc.io.touches import write_touch as write_touch
    from tactile_loc.locate.identify import Identification as Identification
    from tactile_loc.locate.identify import KnownObject as KnownObject
    from tactile_loc.locate.identify import identify as identify
    from tactile_loc.locate.localizer import Localizer as Localizer
    from tactile_loc.locate.probability.null_evidence import NullEvidence as NullEvidence
    from tactile_loc.locate.probability.temperature import TemperatureScaling as TemperatureScaling
    from tactile_loc.locate.result.freedom import Freedom as Freedom
    from tactile_loc.locate.result.hypothesis import Hypothesis as Hypothesis
    from tactile_loc.locate.result.localization import Localization as Localization
    from tactile_loc.locate.result.located_frame import LocatedFrame as LocatedFrame
    from tactile_loc.locate.result.verdict import Verdict as Verdict
    from tactile_loc.locate.several_touches import localize_together as localize_together
    from tactile_loc.locate.touch_files import read_observations as read_observations
    from tactile_loc.planning.approaches import draw_approaches as draw_approaches
    from tactile_loc.planning.approaches import draw_approaches_to_modes as draw_approaches_to_modes
    from tactile_loc.planning.clearance import Clearance as Clearance
    from tactile_loc.planning.clearance import make_box_finger as make_box_finger
    from tactile_loc.planning.hand_eye_calibration import FlangeTouches as FlangeTouches
    from tactile_loc.planning.hand_eye_calibration import HandEyeCalibration as HandEyeCalibration
    from tactile_loc.planning.hand_eye_calibration import calibrate_hand_eye as calibrate_hand_eye
    from tactile_loc.planning.next_step import suggest_next_step as suggest_next_step
    from tactile_loc.planning.next_touch import NextTouch as NextTouch
    from tactile_loc.planning.next_touch import RatedApproach as RatedApproach
    from tactile_loc.planning.next_touch import choose_next_touch as choose_next_touch
    from tactile_loc.reports.page import Page as Page
    from tactile_loc.reports.page import Section as Section
    from tactile_loc.reports.report import write_page as write_page
    from tactile_loc.reports.report import write_report as write_report
    from tactile_loc.reports.scene import frame_surface as frame_surface
    from tactile_loc.sensors.calibration.labelling import LabelledFolder as LabelledFolder
    from tactile_loc.sensors.calibration.labelling import label_presses as label_presses
    from tactile_loc.sensors.calibration.layouts import convert_presses as convert_presses
    from tactile_loc.sensors.calibration.outcome import CalibrationOutcome as CalibrationOutcome
    from tactile_loc.sensors.calibration.outcome import calibrate_folder as calibrate_folder
    from tactile_loc.sensors.calibration.press_table import list_named_files as list_named_files
    from tactile_loc.sensors.reading.photometric import EstimatorRecipe as EstimatorRecipe
    from tactile_loc.sensors.reading.rectification import StatedView as StatedView
    from tactile_loc.simulate.touch_simulation import press_touch as press_touch
    from tactile_loc.slots.code import hash_code as hash_code
    from tactile_loc.store.keys import StageKey as StageKey
    from tactile_loc.store.store import StageStore as StageStore
    from tactile_loc.tracking.frame_fusion import fuse_frames as fuse_frames
    from tactile_loc.tracking.live import LiveLocator as LiveLocator
    from tactile_loc.tracking.pose_modes import PoseModes as PoseModes
    from tactile_loc.tracking.replay import FolderReplay as FolderReplay
    from tactile_loc.tracking.replay import Replay as Replay
    from tactile_loc.tracking.tracked_pose import TrackedPose as TrackedPose
    from tactile_loc.tracking.tracker import Tracker as Tracker
    from tactile_loc.view.calibration import draw_circle as draw_circle
    from tactile_loc.view.calibration import draw_reading as draw_reading
    from tactile_loc.view.calibration import save_held_out as save_held_out
    from tactile_loc.view.calibration import save_labels as save_labels
    from tactile_loc.view.drawn_scene import DrawnScene as DrawnScene
    from tactile_loc.view.drawn_scene import DrawnSensor as DrawnSensor
    from tactile_loc.view.palette import Palette as Palette
    from tactile_loc.view.pictures import draw_result as draw_result
    from tactile_loc.view.pictures import render_figure as render_figure
    from tactile_loc.view.pictures import save_figure as save_figure

__version__: str


def _find_version() -> str:
    from importlib.metadata import version  # it takes longer to import than the rest of this module

    return version("tactile-loc")


__all__, __getattr__, __dir__ = lazy_names(__name__, __version__=_find_version)
