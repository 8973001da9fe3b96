"""The assessment of a result's first pose, and a result's origin: both are computed once, and kept in its files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.io.config import RunConfig
from tactile_loc.io.streams.records import read_versions
from tactile_loc.locate.result.freedom import Freedom
from tactile_loc.locate.result.verdict import Outcome, Verdict
from tactile_loc.slots.registry import SLOTS, registry


@dataclass(frozen=True)
class PoseErrors:
    """Pose errors, metres: see `measure_pose_errors`.

    `of_hypotheses_m` are those of the hypotheses, and `closest_in_grid_m` is that of the nearest grid pose.
    """

    of_hypotheses_m: tuple[float, ...]
    closest_in_grid_m: float

    @property
    def best_m(self) -> float:
        """The error of the first hypothesis, metres."""
        return self.of_hypotheses_m[0]

    @property
    def best_listed_m(self) -> float:
        """The smallest error of the hypotheses, metres."""
        return min(self.of_hypotheses_m)


@dataclass(frozen=True, eq=False)
class Assessment:
    """The assessment of a result's first pose, from all poses that were scored. Files keep only some of these poses.

    The `outcome` has the probability that the first pose is within the tolerance of the true pose. `poor_touches`
    are the numbers of the touches that it explains worse than right poses do. `freedom` is what the touches leave
    open. `next_step` names the next step. `grid_poses` is the number of scored poses, and `entropy_nats` the
    entropy of their posterior. `kept_probability`, 0 to 1, is the probability of the poses that files keep.
    `errors` is None if the true pose is unknown. `error_quantile_m`, metres, is what the pose error does not exceed
    with 95 % probability; None if it may be large.
    """

    verdict: Verdict
    outcome: Outcome | None
    freedom: Freedom
    next_step: str
    grid_poses: int
    entropy_nats: float
    kept_probability: float
    errors: PoseErrors | None = None
    poor_touches: tuple[int, ...] = ()
    error_quantile_m: float | None = None

    @property
    def normalised_entropy(self) -> float:
        """The entropy divided by that of equally probable poses: 0 if one pose is certain, 1 if all are equal."""
        return self.entropy_nats / math.log(self.grid_poses) if self.grid_poses > 1 else 0.0


@dataclass(frozen=True, eq=False)
class Origin:
    """The origin of a result: its time (UTC, ISO 8601), versions of libraries, and all settings.

    `distributions` are, for each slot, the installed package of the chosen component.
    """

    created: str
    versions: dict[str, str]
    configuration: dict[str, Any]
    distributions: dict[str, str]

    @classmethod
    def of(cls, config: RunConfig) -> Origin:
        """Return the origin of a result that is made now. Raises ConfigError when a component refuses its options."""
        packages = {slot: registry().find(slot, getattr(config, slot).name).distribution for slot in SLOTS}
        created = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(created, read_versions(), config.resolve(), packages)

    @property
    def sensor_name(self) -> str:
        """The name of the first touch's sensor, or of its file."""
        sensor = self.configuration["sensor"]
        path = sensor["options"].get("path")
        return show_name(Path(path).stem) if path else str(sensor["name"])
