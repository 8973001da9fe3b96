"""The file `result.json`: the result of a localisation, and all its inputs. SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.tolerance import Tolerance
from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.core.runtime.formatting import format_mm, format_percent, show_name
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import RunConfig, TouchConfig
from tactile_loc.io.mount_files import Covariance
from tactile_loc.io.streams.records import Record, read_document, read_versions
from tactile_loc.io.toml import Matrix
from tactile_loc.locate.probability.conformal import PoseSet
from tactile_loc.locate.probability.probabilities import MOST_ELSEWHERE
from tactile_loc.locate.result.freedom import Freedom
from tactile_loc.locate.result.hypothesis import Agreement, Hypothesis
from tactile_loc.locate.result.verdict import Verdict, describe_within, name_next_step
from tactile_loc.slots.registry import SLOTS, registry

SCHEMA_VERSION = 3
SETS_OF_GRID_POSES = 2  # the version that differs only in sets for a coverage, so files without a set are read


class ObjectRecord(Record):
    """The object that was located."""

    name: str = Field(description="the object's name")
    source: str = Field(description="the mesh file that was read")
    size_m: list[float] = Field(description="size of the surface's bounding box along x, y, z of the object frame, m")
    triangles: int = Field(description="number of triangles of the surface")
    symmetry: str = Field(description="the rotations that map the object onto itself, declared or detected")
    notes: list[str] = Field(description="guesses and warnings from reading the mesh")


class TouchRecord(Record):
    """A touch that was located."""

    name: str = Field(description="the touch's name")
    path: str | None = Field(description="the touch's file; null if the touch was simulated")
    noise: str | None = Field(description="the noise of a simulated touch; null if the touch was read from a file")
    image_px: list[int] = Field(description="size of the contact shape (rows, columns), pixels")
    press_depth_m: float = Field(description="press depth of the contact shape, m")
    indentation_m: float = Field(description="how deep the object was pressed into the gel, m")
    T_base_sensor: Matrix | None = Field(description="the sensor's pose, (4, 4), m; null if unknown")
    T_base_sensor_std_m: float | None = Field(
        default=None, description="standard deviation of the error of `T_base_sensor` along each axis, m"
    )
    T_base_sensor_std_rad: float | None = Field(default=None, description="the same about each axis, rad")
    indentation_std_m: float = Field(
        default=0.0, description="standard deviation of the indentation's error, m, if the sensor knows it; else 0"
    )
    T_sensor_object: Matrix | None = Field(description="the true pose, (4, 4), m; null if unknown")
    best_imprint_iou: float | None = Field(
        default=None, description="with several touches: the best imprint IoU of any pose tried with this touch, 0 to 1"
    )
    outlier: bool = Field(default=False, description="whether the touch contradicts the other touches, which agree")


class HypothesisRecord(Record):
    """One distinct explanation of the touches."""

    rank: int = Field(description="1 for the most probable hypothesis")
    probability: float = Field(description="probability of the hypothesis, with all its grid poses, 0 to 1")
    grid_poses: int = Field(description="number of grid poses that belong to the hypothesis")
    T_sensor_object_grid: Matrix = Field(description="the most probable grid pose of the hypothesis, (4, 4), m")
    T_sensor_object: Matrix = Field(description="the answer: the grid pose after refinement, (4, 4), m")
    imprint_iou: float = Field(
        description="imprint IoU, 0 to 1: how well the refined pose explains the touch in depth and outline; for "
        "several touches, the mean without outliers"
    )
    imprint_ious: list[float] = Field(
        default_factory=list, description="imprint IoU with each touch: `touch`, then `other_touches`"
    )
    prior_nats: float = Field(default=0.0, description="log-weight of the prior at the answer, nats; 0 without a prior")
    contact_iou: float = Field(
        description="contact IoU from the refiner: how well the pose's contact area matches the observed one, 0 to 1"
    )
    converged: bool = Field(description="whether the refinement converged")
    iterations: int = Field(description="number of iterations of the refinement")
    covariance: Covariance | None = Field(
        default=None,
        description="covariance (6, 6) of the answer's error, in the order and frame of ROS's PoseWithCovariance: "
        "x, y, z of the object frame's origin (m), rotations about the sensor's x, y, z axes (rad); null if unknown",
    )
    quaternion_xyzw: list[float] | None = Field(
        default=None, description="the rotation of `T_sensor_object` as a unit quaternion, scalar last"
    )
    T_base_object: Matrix | None = Field(
        default=None,
        description="the answer in the base frame, (4, 4), m; null if the sensor's pose is unknown. For one touch, it "
        "is `T_base_sensor` times `T_sensor_object`. For several, it averages the errors of the sensors' poses",
    )
    base_quaternion_xyzw: list[float] | None = Field(
        default=None, description="the rotation of `T_base_object` as a unit quaternion, scalar last"
    )
    base_covariance: Covariance | None = Field(
        default=None,
        description="covariance (6, 6) of the error of `T_base_object`, in the order and frame of ROS's "
        "PoseWithCovariance: x, y, z of the object frame's origin (m), rotations about the base's x, y, z axes (rad). "
        "It includes the errors of the sensors' poses; null if unknown",
    )
    error_m: float | None = Field(description="surface distance to the true pose, m; null if the true pose is unknown")


class PoseSetRecord(Record):
    """A set of hypotheses that contains the true pose with a known probability."""

    coverage: float = Field(description="the requested probability, 0 to 1")
    poses: int = Field(description="number of hypotheses in the set; they are the listed ones")
    radius_m: float = Field(
        description="a hypothesis counts as the true pose if its surface distance to it is at most this, m"
    )
    elsewhere: bool = Field(
        default=False, description="whether the set also contains `elsewhere`: the true pose may be none of the poses"
    )
    missed: float = Field(description="predicted probability that the true pose is none of the poses found, 0 to 1")
    promised: bool = Field(description="whether the listed poses alone have the coverage")
    reason: str = Field(default="", description="why the listed poses alone do not have the coverage; empty if they do")
    level: float = Field(description="total probability up to which poses are in the set, 0 to 1")
    examples: int = Field(description="number of simulated, held-out examples from which the level was computed")

    @property
    def title(self) -> str:
        """The name of the set: 95 % set."""
        return f"{100 * self.coverage:g} % set"

    @property
    def size(self) -> str:
        """The number of poses, and whether the set contains "elsewhere", in words."""
        poses = "1 pose" if self.poses == 1 else f"{self.poses} poses"
        return f"{poses} or elsewhere" if self.elsewhere else poses

    @property
    def meaning(self) -> str:
        """The probability that the set contains the true pose, or the reason why that is unknown, in words."""
        if not self.promised:
            return self.reason
        return (
            f"The true pose is within {format_mm(self.radius_m)} mm of one of these poses with this probability, "
            f"measured on {self.examples} simulated examples."
        )


class ErrorRecord(Record):
    """Errors: surface distances to the true pose. For a symmetric object, the smallest over its symmetry counts."""

    best_m: float = Field(description="error of the first hypothesis, m")
    best_listed_m: float = Field(description="smallest error of the listed hypotheses, m")
    closest_in_grid_m: float = Field(description="error of the grid pose nearest to the true pose, m")


class FreedomRecord(Record):
    """What the touches leave open about the first hypothesis."""

    others: int = Field(description="number of other hypotheses that explain the touches equally well")
    slide_m: list[float] = Field(description="largest possible slide along the sensor's x, y, z, m; 0 if small")
    turn_rad: list[float] = Field(
        description="largest possible turn in place, a rotation vector about the sensor's x, y, z, rad; 0 if small"
    )

    def __str__(self) -> str:
        """Return the freedom in words; empty if nothing is open."""
        return str(Freedom(self.others, np.array(self.slide_m), np.array(self.turn_rad)))


class ResultRecord(Record):
    """The whole file."""

    schema_version: int = Field(
        default=SCHEMA_VERSION,
        description="version of this format; it increases if a key is removed or gets another meaning",
    )
    created: str = Field(description="date and time, UTC, ISO 8601")
    versions: dict[str, str] = Field(description="versions of tactile-loc, Python and the installed libraries")
    configuration: dict[str, Any] = Field(
        description="all settings, including defaults; `tactile-loc run --config` reads the same entries as TOML"
    )
    distributions: dict[str, str] = Field(description="for each slot, the installed package of the chosen component")
    object: ObjectRecord = Field(description="the object")
    touch: TouchRecord = Field(description="the touch, or the first of several; poses are in the frame of its sensor")
    other_touches: list[TouchRecord] = Field(description="the other touches that were fused with `touch`")
    contradictory: bool = Field(
        default=False,
        description="true if no pose found explains all touches; touches that contradict the others are marked "
        "`outlier`, unless it is unknown which touches are wrong",
    )
    left_out: list[TouchRecord] = Field(
        default_factory=list, description="touches that were left out, because they contradict the others"
    )
    verdict: Verdict | None = Field(
        default=None,
        description="whether the first hypothesis can be trusted: `certain`, `ambiguous`, `poor fit` or `not found`; "
        "null in files of versions without verdicts",
    )
    tolerance: str | None = Field(
        default=None, description="the largest error of a right pose, as in the configuration: 1mm or 0.5mm,2deg"
    )
    probability_within: float | None = Field(
        default=None,
        description="probability that the first hypothesis is within the tolerance of the true pose, 0 to 1; null if "
        "it is only known to be beyond a limit of the fit, such as 0.89 for a pose that the touches leave open",
    )
    unexpected: bool = Field(
        default=False,
        description="whether the prior makes the first hypothesis very improbable; then it is not certain",
    )
    freedom: FreedomRecord | None = Field(
        default=None, description="what the touches leave open; null in files of versions without it"
    )
    next_step: str = Field(default="", description="what to do next, in words; empty if the verdict is certain")
    grid_poses: int = Field(description="number of scored poses; with the grid `whole`, of poses that the search found")
    elsewhere: float = Field(
        default=0.0,
        description=f"probability that the true pose is near none of the scored poses; {MOST_ELSEWHERE} is a limit",
    )
    normalised_entropy: float = Field(
        description="entropy / log(grid_poses): 0 if one pose is certain, 1 if all poses are equally probable"
    )
    posterior_touches: int = Field(
        default=1, description="number of touches behind the posterior, with those behind a prior"
    )
    entropy_nats: float = Field(description="Shannon entropy of the posterior, nats")
    hypotheses: list[HypothesisRecord] = Field(min_length=1, description="distinct explanations, the best first")
    pose_set: PoseSetRecord | None = Field(
        description="the set that the hypotheses are; null unless a coverage was requested"
    )
    errors: ErrorRecord | None = Field(description="errors of the answer; null if the true pose is unknown")
    seconds: dict[str, float] = Field(description="duration of each stage, s")

    @property
    def sensor_name(self) -> str:
        """The name of the sensor or of its file."""
        sensor = self.configuration.get("sensor", {})
        path = sensor.get("options", {}).get("path")
        return show_name(Path(path).stem) if path else str(sensor.get("name", "a sensor"))

    @property
    def errors_m(self) -> list[float] | None:
        """Each hypothesis's surface distance (K,), metres, to the true pose; None if the true pose is unknown."""
        return [h.error_m for h in self.hypotheses if h.error_m is not None] or None

    @property
    def says_within(self) -> str:
        """The probability that the first pose is right, in words; empty if the verdict makes it misleading."""
        if self.tolerance is None:  # a file of an older version
            return ""
        return describe_within(self.verdict, self.probability_within, Tolerance.parse(self.tolerance))

    @property
    def searched(self) -> str:
        """The number of scored poses and the probability that the object is at none of them, in words."""
        if not self.elsewhere:
            return f"{self.grid_poses} poses searched"
        if self.elsewhere >= MOST_ELSEWHERE:
            return f"{self.grid_poses} poses found, but the true pose is probably elsewhere"
        elsewhere = f"{format_percent(self.elsewhere)} probability that the true pose is elsewhere"
        return f"{self.grid_poses} likely poses found, {elsewhere}"


def read_record(path: Path) -> ResultRecord:
    """Read result.json. Raises ResultError if the file cannot be used."""
    document = read_document(path)
    version = document.get("schema_version")
    if version == SETS_OF_GRID_POSES and document.get("pose_set") is None:
        version = SCHEMA_VERSION
    if version != SCHEMA_VERSION:
        reads = f"this tactile-loc reads version {SCHEMA_VERSION}"
        raise ResultError(f"{path} has version {version}, but {reads}; run tactile-loc again")
    try:
        return ResultRecord.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ResultError(f"{path} is damaged: {where}: {first['msg']}; run tactile-loc again") from error


class Configured(Protocol):
    """A located object and its configuration, such as those of a Localizer."""

    @property
    def config(self) -> RunConfig:
        """All settings."""

    @property
    def object(self) -> ObjectModel:
        """The object."""


class Located(Protocol):
    """The parts of a Localization that are written."""

    @property
    def touch(self) -> Touch:
        """See Localization."""

    @property
    def touches(self) -> tuple[Touch, ...]:
        """See Localization."""

    @property
    def posterior(self) -> PosePosterior:
        """See Localization."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """See Localization."""

    @property
    def seconds(self) -> dict[str, float]:
        """See Localization."""

    @property
    def pose_set(self) -> PoseSet | None:
        """See Localization."""

    @property
    def agreement(self) -> Agreement:
        """See Localization."""

    @property
    def left_out(self) -> tuple[Touch, ...]:
        """See Localization."""

    @property
    def verdict(self) -> Verdict:
        """See Localization."""

    @property
    def tolerance(self) -> Tolerance:
        """See Localization."""

    @property
    def unexpected(self) -> bool:
        """See Localization."""

    @property
    def freedom(self) -> Freedom:
        """See Localization."""

    @property
    def normalised_entropy(self) -> float:
        """See Localization."""

    def state_within(self, tolerance: Tolerance | str | None = None) -> float | None:
        """See Localization."""

    def measure_errors_m(self, obj: ObjectModel) -> NDArray[np.float64] | None:
        """See Localization."""


def make_record(source: Configured, localization: Located, seconds: Mapping[str, float] | None = None) -> ResultRecord:
    """Make the record of a localisation by a localizer. `seconds` has the durations of other stages to add."""
    config, posterior = source.config, localization.posterior
    touches = _record_touches(localization, config.touch)
    errors_m = localization.measure_errors_m(source.object)
    return ResultRecord(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=read_versions(),
        configuration=config.resolve(),
        distributions={slot: registry().find(slot, getattr(config, slot).name).distribution for slot in SLOTS},
        object=_record_object(source.object),
        touch=touches[0],
        other_touches=touches[1:],
        contradictory=localization.agreement.contradictory,
        left_out=[_record_touch(touch, config.touch) for touch in localization.left_out],
        verdict=localization.verdict,
        tolerance=str(localization.tolerance),
        probability_within=localization.state_within(),
        unexpected=localization.unexpected,
        freedom=_record_freedom(localization.freedom),
        next_step=name_next_step(localization.verdict, len(localization.touches)),
        grid_poses=len(posterior.grid),
        elsewhere=posterior.elsewhere,
        posterior_touches=posterior.touches,
        normalised_entropy=localization.normalised_entropy,
        entropy_nats=posterior.entropy,
        hypotheses=_record_hypotheses(localization, errors_m),
        pose_set=_record_pose_set(localization.pose_set),
        errors=_record_errors(localization, errors_m),
        seconds={**(seconds or {}), **localization.seconds},
    )


def _record_object(obj: ObjectModel) -> ObjectRecord:
    return ObjectRecord(
        name=obj.name, source=obj.source, size_m=obj.mesh.extents_m.tolist(), triangles=len(obj.mesh.faces),
        symmetry=str(obj.symmetry), notes=list(obj.notes),
    )  # fmt: skip


def _record_touch(touch: Touch, source: TouchConfig) -> TouchRecord:
    placed = touch.T_base_sensor is not None
    return TouchRecord(
        name=touch.name, path=source.path, noise=source.noise if source.path is None else None,
        image_px=list(touch.geometry.shape), press_depth_m=touch.press_depth_m, indentation_m=touch.indentation_m,
        T_base_sensor=_list_rows(touch.T_base_sensor), T_sensor_object=_list_rows(touch.T_sensor_object),
        T_base_sensor_std_m=touch.T_base_sensor_std_m if placed else None,
        T_base_sensor_std_rad=touch.T_base_sensor_std_rad if placed else None,
        indentation_std_m=touch.contact_shape.indentation_std_m,
    )  # fmt: skip


def _record_touches(localization: Located, source: TouchConfig) -> list[TouchRecord]:
    agreement = localization.agreement
    records = [_record_touch(touch, source) for touch in localization.touches]
    return [
        record.model_copy(update={"best_imprint_iou": best, "outlier": number in agreement.outliers})
        for number, (record, best) in enumerate(zip(records, agreement.best_ious or [None] * len(records), strict=True))
    ]


def _record_hypotheses(localization: Located, errors_m: NDArray[np.float64] | None) -> list[HypothesisRecord]:
    return [
        HypothesisRecord(
            rank=i + 1, probability=h.probability, grid_poses=h.grid_poses,
            T_sensor_object_grid=h.T_sensor_object_grid.tolist(), T_sensor_object=h.T_sensor_object.tolist(),
            imprint_iou=h.imprint_iou, imprint_ious=list(h.imprint_ious), prior_nats=h.prior_nats,
            contact_iou=h.refined.contact_iou, covariance=_list_rows(h.covariance),
            quaternion_xyzw=_list_numbers(h.quaternion_xyzw),
            T_base_object=_list_rows(h.T_base_object), base_quaternion_xyzw=_list_numbers(h.base_quaternion_xyzw),
            base_covariance=_list_rows(h.base_covariance),
            converged=h.refined.converged, iterations=h.refined.iterations,
            error_m=None if errors_m is None else float(errors_m[i]),
        )
        for i, h in enumerate(localization.hypotheses)
    ]  # fmt: skip


def _record_freedom(found: Freedom) -> FreedomRecord:
    return FreedomRecord(others=found.others, slide_m=found.slide_m.tolist(), turn_rad=found.turn_rad.tolist())


def _record_pose_set(found: PoseSet | None) -> PoseSetRecord | None:
    return None if found is None else PoseSetRecord(**asdict(found))


def _record_errors(localization: Located, errors_m: NDArray[np.float64] | None) -> ErrorRecord | None:
    T_true = localization.touch.T_sensor_object
    if errors_m is None or T_true is None:
        return None
    closest_m = localization.posterior.grid.nearest(T_true[None])[0][0]
    return ErrorRecord(
        best_m=float(errors_m[0]), best_listed_m=float(errors_m.min()), closest_in_grid_m=float(closest_m)
    )


def _list_numbers(q: NDArray[np.float64] | None) -> list[float] | None:
    return None if q is None else list(q.tolist())


def _list_rows(T: NDArray[np.float64] | None) -> Matrix | None:
    return None if T is None else np.asarray(T, float).tolist()
