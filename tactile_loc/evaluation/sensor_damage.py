"""The pose errors that the faults of a sensor would cause on a reference part."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.poses.priors import GaussianPrior
from tactile_loc.core.runtime.errors import TactileLocError
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.locate.localizer import Localizer
from tactile_loc.sensors.calibration.folder import Calibration
from tactile_loc.sensors.reading.passport import Examination, SensorFinding
from tactile_loc.sensors.reading.reading import find_contact_shape, find_gel_surface, recover_indentation
from tactile_loc.sensors.reading.surface import differentiate, find_indentation
from tactile_loc.store.store import StageStore

PART, TOUCHES, SEED = "cotter", 5, 0
PRIOR_M, PRIOR_RAD = 0.005, 0.3  # standard deviations of what is known of the pose: one touch of a part is ambiguous


@dataclass(frozen=True, eq=False)
class Damage:
    """The median pose error, metres, of touches of the reference part, and the first touch as the sensor reads it.

    `error_m` is inf and `touch` is None if no contact is read. `finding` is None for the sensor without faults.
    """

    finding: SensorFinding | None
    error_m: float
    touch: Touch | None


def measure_damage(
    sensor: Calibration, seen: Examination, findings: Sequence[SensorFinding], store: StageStore | None = None
) -> list[Damage]:
    """Return the pose errors of simulated touches: without faults, and with each fault that changes what is read."""
    localizer = Localizer.create(PART, sensor={"name": "calibrated", "path": str(sensor.folder)}, store=store)
    touches = localizer.simulate(TOUCHES, SEED)
    faults = [one for one in findings if one.is_fault and one.check.distort is not None]
    return [_locate(localizer, sensor, touches, seen, finding) for finding in (None, *faults)]


def _locate(
    localizer: Localizer,
    sensor: Calibration,
    touches: Sequence[Touch],
    seen: Examination,
    finding: SensorFinding | None,
) -> Damage:
    errors, read = [], []
    for touch in touches:
        T = touch.T_sensor_object
        assert T is not None  # simulated
        try:
            shown = replace(touch, contact_shape=_read_shape(sensor, touch, seen, finding))
            best = localizer.localize(shown, GaussianPrior(T, PRIOR_M, PRIOR_RAD)).best
        except TactileLocError:
            errors.append(np.inf)
            continue
        read.append(shown)
        errors.append(float(measure_pose_errors(localizer.object, best.T_sensor_object[None], T)[0]))
    return Damage(finding, float(np.median(errors)), read[0] if read else None)


def _read_shape(sensor: Calibration, touch: Touch, seen: Examination, finding: SensorFinding | None) -> ContactShape:
    """Return the contact shape that is read from a touch's slopes after a fault has changed them."""
    geometry, shape = sensor.geometry, touch.contact_shape
    displaced = np.where(shape.contact, shape.press_depth_m - shape.depth_m, 0.0)
    slopes: Floats = np.asarray(differentiate(displaced, geometry), np.float64)
    if finding is not None:
        assert finding.check.distort is not None
        slopes = finding.check.distort(seen, slopes)
    indentation = find_indentation(slopes, geometry)
    if not geometry.gel.is_elastic:
        return find_contact_shape(indentation, geometry, sensor.noise_m)
    indentation = recover_indentation(indentation, slopes.astype(np.float32), geometry)
    return find_gel_surface(indentation, geometry, sensor.noise_m)
