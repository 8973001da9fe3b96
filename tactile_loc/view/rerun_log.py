"""Results, frames and replayed recordings as files (.rrd) for the Rerun viewer. Nothing here starts the viewer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.lie import rotate_covariance
from tactile_loc.core.geometry.pose_words import format_pose_words
from tactile_loc.core.geometry.rigid import invert, rotation_to_quaternion_xyzw
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import MissingLibraryError, OutputError
from tactile_loc.core.runtime.formatting import format_percent, is_unicode
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.result_arrays import find_most_probable, reduce_mesh
from tactile_loc.store.files import require_writable, write_atomically
from tactile_loc.tracking.replay import FrameRecord, ReplaySource

SENSOR = "base/sensor"
OBJECT, HYPOTHESES, POSTERIOR, SPREAD = (f"{SENSOR}/{n}" for n in ("object", "hypotheses", "posterior", "uncertainty"))
STEEL, GHOST, HIDDEN = (124, 159, 199, 255), (124, 159, 199, 50), (0, 0, 0, 0)
GEL = (223, 225, 220)
DEVIATIONS = 2.0  # standard deviations of an ellipsoid's half axes
FLUSH_S = 30.0  # longest time for writing a frame to the disk
MARK_M = 5e-4  # radius of the mark of the most probable pose


def require_rerun(path: Path) -> None:
    """Raise OutputError if `path` cannot be written as a Rerun file, and MissingLibraryError without rerun-sdk."""
    if path.suffix.lower() != ".rrd":
        raise OutputError(f"`rerun` {path.name} must end in .rrd; choose another name")
    if path.is_dir():
        raise OutputError(f"{path} is a folder; choose another `rerun`")
    if not is_unicode(path):
        raise OutputError(f"`rerun` {path} cannot be written by rerun-sdk; choose a name in Unicode")
    require_writable(path.parent)
    _import_rerun()


def _import_rerun() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise MissingLibraryError(
            "`rerun` needs rerun-sdk, which is not installed: pip install 'tactile-loc[view]'"
        ) from error
    return rerun


@dataclass(frozen=True, eq=False)
class Logged:
    """One frame of a Rerun file. Missing parts are None.

    `time_s` is the time in seconds since the start of the file. `image` is (H, W, 3). `says` is a text to show.
    """

    number: int
    time_s: float
    image: NDArray[np.uint8] | None = None
    touch: Touch | None = None
    located: LocatedFrame | None = None
    posterior: PosePosterior | None = None
    says: str = ""


class RerunLog:
    """Context manager that writes a Rerun file frame by frame.

    Poses are in the sensor frame, in metres. A touch's T_base_sensor places the sensor in the base frame. `scene` has
    the object and the sensor. `add` and the end of the context raise OutputError if the file cannot be written.
    """

    def __init__(self, path: Path, scene: Scene) -> None:
        self._rr, self._name, self._refused = _import_rerun(), path.name, False
        path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = self._rr.RecordingStream(f"tactile-loc {scene.object.name}")
        self._stream.save(path)
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._shown: dict[str, bool] = {}
        self._begin(reduce_mesh(scene.object.mesh), scene.geometry)

    def __enter__(self) -> RerunLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self._flush()
        if not self._refused:  # otherwise Rerun would wait for its writer forever
            self._stream.disconnect()

    def add(self, frame: Logged) -> None:
        """Add a frame. If the frame lacks an image, touch or pose, the viewer hides that of the frame before."""
        self._stream.set_time("frame", sequence=frame.number)
        self._stream.set_time("time", duration=frame.time_s)
        self._add_touch(frame.image, frame.touch)
        has_pose = frame.located is not None and len(frame.located.T_sensor_object_modes) > 0
        if frame.located is not None and has_pose:
            self._add_poses(frame.located)
        else:
            self._log(SPREAD, self._rr.Clear(recursive=False))
        for path, colour in ((OBJECT, STEEL), (HYPOTHESES, GHOST)):
            self._show(path, has_pose, colour)
        if frame.posterior is not None:
            self._add_posterior(frame.posterior)
        self._log("pose", self._rr.TextDocument(describe_pose(frame)))
        self._flush()

    def _flush(self) -> None:
        """Wait until all data are on the disk. Raises OutputError if Rerun cannot write the data."""
        try:
            self._stream.flush(timeout_sec=FLUSH_S)
        except RuntimeError as error:
            self._refused = True
            raise OutputError(
                f"{self._name} cannot be written ({error}); free some space, or choose another `rerun`"
            ) from error

    def _log(self, path: str, what: Any, static: bool = False) -> None:
        self._stream.log(path, what, static=static)

    def _begin(self, mesh: TriangleMesh, geometry: SensorGeometry) -> None:
        """Write the gel, and the object's surface, which is hidden at first."""
        shape = {"vertex_positions": mesh.vertices_m, "triangle_indices": mesh.faces}
        self._stream.set_time("frame", sequence=0)
        self._stream.set_time("time", duration=0.0)
        for path in (f"{OBJECT}/surface", HYPOTHESES):
            self._log(path, self._rr.Mesh3D(**shape, albedo_factor=HIDDEN))
        x0, x1, y0, y1 = geometry.rectangle
        gel = self._rr.Boxes3D(centers=[geometry.gel_middle_m], sizes=[[x1 - x0, y1 - y0, 0.0]], colors=[GEL])
        self._log(f"{SENSOR}/gel", gel, static=True)

    def _show(self, path: str, shown: bool, colour: tuple[int, int, int, int]) -> None:
        """Show or hide a surface."""
        if self._shown.get(path, False) != shown:
            self._shown[path] = shown
            surface = f"{OBJECT}/surface" if path == OBJECT else path
            self._log(surface, self._rr.Mesh3D.from_fields(albedo_factor=colour if shown else HIDDEN))

    def _add_touch(self, image: NDArray[np.uint8] | None, touch: Touch | None) -> None:
        rr, nothing = self._rr, self._rr.Clear(recursive=False)
        self._log("image", nothing if image is None or image.ndim != 3 else rr.Image(image))
        shape = None if touch is None else touch.contact_shape
        self._log("contact_shape", nothing if shape is None else rr.DepthImage(shape.depth_m, meter=1.0))
        if touch is not None and touch.T_base_sensor is not None:
            self._log(SENSOR, self._make_transform(touch.T_base_sensor))

    def _make_transform(self, T: NDArray[np.float64]) -> Any:
        return self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def _add_poses(self, found: LocatedFrame) -> None:
        rr, poses = self._rr, found.T_sensor_object_modes
        self._log(OBJECT, self._make_transform(poses[0]))
        self._log(HYPOTHESES, rr.InstancePoses3D(translations=poses[:, :3, 3], mat3x3=poses[:, :3, :3]))
        self._log(HYPOTHESES, rr.AnyValues(probability=found.probabilities))
        self._log("plots/probability", rr.Scalars(found.probabilities[0]))
        if not np.isnan(found.imprint_iou):
            self._log("plots/imprint_iou", rr.Scalars(found.imprint_iou))
        if found.covariance is None:
            self._log(SPREAD, rr.Clear(recursive=False))
            return
        self._log(SPREAD, self._make_ellipsoid(poses[0, :3, 3], found.covariance[:3, :3]))
        self._log(SPREAD, rr.AnyValues(covariance=found.covariance.ravel()))

    def _make_ellipsoid(self, centre_m: NDArray[np.float64], covariance: NDArray[np.float64]) -> Any:
        """Return an ellipsoid of the position's uncertainty; its half axes are `DEVIATIONS` standard deviations."""
        variances, R = np.linalg.eigh(covariance)
        R[:, 0] *= np.sign(np.linalg.det(R))  # make the axes right-handed
        half = DEVIATIONS * np.sqrt(np.maximum(variances, 0))
        rotation = self._rr.Quaternion(xyzw=rotation_to_quaternion_xyzw(R))
        return self._rr.Ellipsoids3D(centers=[centre_m], half_sizes=[half], quaternions=[rotation])

    def _add_posterior(self, posterior: PosePosterior) -> None:
        """Write the posterior's most probable poses as marks at the object's origin. Larger marks are more probable."""
        kept = find_most_probable(posterior)
        poses, p = posterior.grid.T_sensor_object[kept], posterior.probabilities[kept]
        self._log(POSTERIOR, self._rr.Points3D(poses[:, :3, 3], radii=MARK_M * np.sqrt(p / p.max())))
        self._log(POSTERIOR, self._rr.AnyValues(T_sensor_object=poses.reshape(-1), probability=p))


def describe_pose(frame: Logged) -> str:
    """Describe a frame's pose in words, in mm, degrees and per cent."""
    found = frame.located
    if found is None:
        return frame.says
    said = frame.says or found.says
    if found.T_sensor_object is None:
        return "\n".join(line for line in (found.word, said) if line)
    words = format_pose_words(found.T_sensor_object, found.std)
    std = "" if found.std is None else f"\nstd {words.place_std} mm; {words.turn_std} about x, y, z"
    lines = (
        f"{found.word}, {format_percent(float(found.probabilities[0]))}",
        f"{words.place} mm, rotated {words.turn} about {words.axis}{std}",
        said,
    )
    return "\n".join(line for line in lines if line)


def write_localization(path: Path, localization: Localization, scene: Scene) -> Path:
    """Write a result atomically as a Rerun file with a frame for each touch, and return the path.

    Raises OutputError if the file cannot be written, and MissingLibraryError if rerun-sdk is not installed.
    """

    def write(temporary: Path) -> None:
        first, located = localization.touch, LocatedFrame.of(localization)
        with RerunLog(temporary, scene) as log:
            log.add(Logged(0, 0.0, first.image, first, located, localization.posterior, first.name))
            for number, touch in enumerate(localization.others, 1):
                T_other_first = invert(np.asarray(touch.T_base_sensor)) @ np.asarray(first.T_base_sensor)
                seen = located.view_from(T_other_first)
                log.add(Logged(number, float(number), touch.image, touch, seen, says=touch.name))

    return write_atomically(path, write)


def write_replay(path: Path, source: ReplaySource, records: Sequence[FrameRecord]) -> Path:
    """Write the results of a replay atomically as a Rerun file, and return the path.

    The images are read again. Raises OutputError if the file cannot be written, and MissingLibraryError if rerun-sdk is
    not installed.
    """

    def write(temporary: Path) -> None:
        with RerunLog(temporary, source.localizer.scene) as log:
            for record, frame in zip(records, source.read_frames(), strict=True):
                time_s = 1e-9 * (record.stamp_ns - records[0].stamp_ns)
                located = _locate_in_sensor(record, frame.T_base_sensor)
                log.add(Logged(record.number, time_s, frame.image, frame.touch, located))

    return write_atomically(path, write)


def _locate_in_sensor(record: FrameRecord, T_base_sensor: NDArray[np.float64] | None) -> LocatedFrame:
    """Return a record's result in the sensor's frame."""
    if record.T_frame_object is None:
        return LocatedFrame(record.verdict, says=record.says)
    T = np.eye(4) if T_base_sensor is None else invert(T_base_sensor)
    covariance = None if record.covariance is None else rotate_covariance(np.array(record.covariance), T[:3, :3])
    shares, iou = np.array([record.probability or 0.0]), record.imprint_iou
    return LocatedFrame(
        record.verdict, (T @ record.T)[None], shares, covariance, np.nan if iou is None else iou, says=record.says
    )
