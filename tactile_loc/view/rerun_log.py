"""Results, frames and replayed recordings as files (.rrd) for the Rerun viewer. Nothing here starts the viewer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, invert, rotation_to_quaternion_xyzw
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.errors import MissingLibraryError, OutputError
from tactile_loc.core.runtime.formatting import is_unicode
from tactile_loc.core.sensing.scene import Scene, relate_sensors
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.result_arrays import reduce_mesh
from tactile_loc.store.files import require_writable, write_atomically
from tactile_loc.tracking.replay import ReplayedFrame, ReplaySource
from tactile_loc.view.drawn_scene import GEL, STEEL, DrawnScene, DrawnSensor, describe_located

SENSOR = "base/sensor"
OBJECT, HYPOTHESES, POSTERIOR, SPREAD = (f"{SENSOR}/{n}" for n in ("object", "hypotheses", "posterior", "uncertainty"))
SOLID, GHOST, HIDDEN = 1.0, 0.2, 0.0  # opacity of a surface
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
        self._log, self._shown = self._stream.log, dict[str, bool]()
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

    def add(self, number: int, time_s: float, frame: DrawnScene) -> None:
        """Add a frame of one sensor, `time_s` seconds after the start; poses are in the sensor's frame.

        If the frame lacks an image, touch or pose, the viewer hides that of the frame before.
        """
        self._stream.set_time("frame", sequence=number)
        self._stream.set_time("time", duration=time_s)
        self._add_touch(frame.sensors[0])
        has_pose = len(frame.poses) > 0
        if has_pose:
            self._add_poses(frame)
        else:
            self._log(SPREAD, self._rr.Clear(recursive=False))
        for path, opacity in ((OBJECT, SOLID), (HYPOTHESES, GHOST)):
            self._show(path, has_pose, opacity)
        if len(frame.likely):
            self._add_posterior(frame)
        self._log("pose", self._rr.TextDocument(frame.text))
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

    def _begin(self, mesh: TriangleMesh, geometry: SensorGeometry) -> None:
        """Write the gel, and the object's surface, which is hidden at first."""
        shape = {"vertex_positions": mesh.vertices_m, "triangle_indices": mesh.faces}
        self._stream.set_time("frame", sequence=0)
        self._stream.set_time("time", duration=0.0)
        for path in (f"{OBJECT}/surface", HYPOTHESES):
            self._log(path, self._rr.Mesh3D(**shape, albedo_factor=[*STEEL, HIDDEN]))
        x0, x1, y0, y1 = geometry.rectangle
        gel = self._rr.Boxes3D(centers=[geometry.gel_middle_m], sizes=[[x1 - x0, y1 - y0, 0.0]], colors=[GEL])
        self._log(f"{SENSOR}/gel", gel, static=True)

    def _show(self, path: str, shown: bool, opacity: float) -> None:
        """Show or hide a surface."""
        if self._shown.get(path, False) != shown:
            self._shown[path] = shown
            surface = f"{OBJECT}/surface" if path == OBJECT else path
            self._log(surface, self._rr.Mesh3D.from_fields(albedo_factor=[*STEEL, opacity if shown else HIDDEN]))

    def _add_touch(self, sensor: DrawnSensor) -> None:
        rr, nothing, image, touch = self._rr, self._rr.Clear(recursive=False), sensor.image, sensor.touch
        self._log("image", nothing if image is None or image.ndim != 3 else rr.Image(image))
        shape = None if touch is None else touch.contact_shape
        self._log("contact_shape", nothing if shape is None else rr.DepthImage(shape.depth_m, meter=1.0))
        if touch is not None and touch.T_base_sensor is not None:
            self._log(SENSOR, self._make_transform(touch.T_base_sensor))

    def _make_transform(self, T: Floats) -> Any:
        return self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def _add_poses(self, frame: DrawnScene) -> None:
        rr, poses, ellipsoid = self._rr, frame.poses, frame.find_ellipsoid()
        self._log(OBJECT, self._make_transform(poses[0]))
        self._log(HYPOTHESES, rr.InstancePoses3D(translations=poses[:, :3, 3], mat3x3=poses[:, :3, :3]))
        self._log(HYPOTHESES, rr.AnyValues(probability=frame.probabilities))
        self._log("plots/probability", rr.Scalars(frame.probabilities[0]))
        if not np.isnan(frame.imprint_iou):
            self._log("plots/imprint_iou", rr.Scalars(frame.imprint_iou))
        if ellipsoid is None:
            self._log(SPREAD, rr.Clear(recursive=False))
            return
        rotation = rr.Quaternion(xyzw=rotation_to_quaternion_xyzw(ellipsoid.axes))
        centre, half = ellipsoid.centre_m, ellipsoid.half_axes_m
        self._log(SPREAD, rr.Ellipsoids3D(centers=[centre], half_sizes=[half], quaternions=[rotation]))
        self._log(SPREAD, rr.AnyValues(covariance=np.asarray(frame.covariances[0]).ravel()))

    def _add_posterior(self, frame: DrawnScene) -> None:
        """Write the posterior's most probable poses as marks at the object's origin. Larger marks are more probable."""
        poses, p = frame.likely_poses, frame.likely
        self._log(POSTERIOR, self._rr.Points3D(poses[:, :3, 3], radii=MARK_M * np.sqrt(p / p.max())))
        self._log(POSTERIOR, self._rr.AnyValues(T_sensor_object=poses.reshape(-1), probability=p))


def write_localization(path: Path, localization: Localization, scene: Scene) -> Path:
    """Write a result atomically as a Rerun file with a frame for each touch, and return the path.

    Raises OutputError if the file cannot be written, and MissingLibraryError if rerun-sdk is not installed.
    """

    def write(temporary: Path) -> None:
        first, located = localization.touch, LocatedFrame.of(localization)
        with RerunLog(temporary, scene) as log:
            drawn = DrawnScene.of(localization)
            log.add(0, 0.0, replace(drawn, text=describe_located(located, first.name)))
            for number, touch in enumerate(localization.others, 1):
                seen = located.view_from(relate_sensors(touch, first))
                sensor = DrawnSensor.of(touch)
                log.add(number, float(number), DrawnScene.of_frame(scene, seen, sensor, touch.name))

    return write_atomically(path, write)


def write_replay(path: Path, source: ReplaySource, records: Sequence[ReplayedFrame]) -> Path:
    """Write the results of a replay atomically as a Rerun file, and return the path.

    The images are read again. Raises OutputError if the file cannot be written, and MissingLibraryError if rerun-sdk is
    not installed.
    """

    def write(temporary: Path) -> None:
        with RerunLog(temporary, source.localizer.scene) as log:
            for record, frame in zip(records, source.read_frames(), strict=True):
                time_s = 1e-9 * (record.stamp_ns - records[0].stamp_ns)
                T_base_sensor = np.eye(4) if frame.T_base_sensor is None else frame.T_base_sensor
                located = record.located.view_from(invert(T_base_sensor))
                sensor = DrawnSensor(source.localizer.scene.geometry, touch=frame.touch, image=frame.image)
                log.add(record.number, time_s, DrawnScene.of_frame(source.localizer.scene, located, sensor))

    return write_atomically(path, write)
