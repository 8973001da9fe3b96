"""Numbers of the search, of hypotheses and of the tracker that a user may tune: tables of the configuration.

On the command line they are options as components' are: `-o search.registered=500`, `-o tracker.modes=4`.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

TUNABLE = ("search", "hypotheses", "tracker")
CERTAIN = 0.9  # probability from which a pose is certain


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SearchOptions(_Options):
    """How many places of a whole object are compared, registered and drawn. Turned places are places times yaws."""

    candidates: int = Field(default=1000, ge=1, description="most similar rotated places taken for one touch")
    candidates_together: int = Field(default=3000, ge=1, description="the same for each of several touches")
    pool: int = Field(default=30_000, ge=1, description="most similar rotated places among which a prior chooses")
    registered: int = Field(default=300, ge=1, description="poses registered roughly to one touch")
    registered_together: int = Field(default=60, ge=1, description="poses registered roughly to several touches")
    registered_widely: int = Field(default=400, ge=1, description="the same if those explain the touches badly")
    wide_below_iou: float = Field(default=0.8, ge=0, le=1, description="mean imprint IoU that counts as badly, 0 to 1")
    points: int = Field(default=200, ge=20, description="points of a touch in rough registration")
    iterations: int = Field(default=8, ge=2, description="steps of rough registration")
    registration_px: int = Field(default=60, ge=16, description="image side of a touch in rough registration, pixels")
    image_px: int = Field(default=40, ge=16, description="image side at which registered poses are drawn, pixels")
    apart_mm: float = Field(default=0.5, gt=0, description="distance between poses that are kept, mm")
    free_z_mm: float = Field(default=1.0, ge=0, description="freedom along z of poses drawn for several touches, mm")


class HypothesisOptions(_Options):
    """Which poses are refined, and when two are one hypothesis."""

    mode_radius: float = Field(default=2.0, gt=0, description="poses this near are one mode, grid spacings")
    start_radius: float = Field(default=0.25, gt=0, description="distance between poses to refine, mode radii")
    merge_radius: float = Field(default=0.25, gt=0, description="refined poses this near are one, mode radii")
    refined: int = Field(default=20, ge=1, description="least poses of a whole object that are refined")
    refined_together: int = Field(default=40, ge=1, description="poses of a listed grid refined to several touches")
    refined_again: int = Field(default=12, ge=1, description="poses refined without a touch that may contradict")
    listed: int = Field(default=400, ge=1, description="most probable poses that each of several touches proposes")
    drawn: int = Field(default=200, ge=1, description="proposed poses that are drawn coarsely")
    image_px: int = Field(default=40, ge=16, description="image side at which they are drawn, pixels")


class TrackerOptions(_Options):
    """What the tracker follows, what it takes for the same contact, and when it searches."""

    modes: int = Field(default=8, ge=1, description="most poses that are followed")
    certain: float = Field(default=CERTAIN, gt=0, lt=1, description="probability from which a mode is the pose, 0 to 1")
    improbable: float = Field(
        default=1e-4, gt=0, lt=1, description="modes less probable than this share of the first go"
    )
    common: float = Field(
        default=0.75, ge=0, lt=1, description="share of a touch's covariance that the next one repeats"
    )
    apart_mm: float = Field(default=3.0, gt=0, description="sensor motion after which 1/e of that is repeated, mm")
    lever_mm: float = Field(default=10.0, gt=0, description="lever by which a turn counts as motion, mm")
    keyframe_mm: float = Field(default=2.0, gt=0, description="sensor motion between two keyframes, mm")
    keyframes: int = Field(default=5, ge=1, description="most keyframes that are searched for together")
    image_px: int = Field(default=60, ge=16, description="image side at which modes are drawn, pixels")
    fall_iou: float = Field(
        default=0.15, ge=0, le=1, description="loss of imprint IoU that contradicts the track, 0 to 1"
    )
    least_iou: float = Field(
        default=0.25, ge=0, le=1, description="imprint IoU below which a pose explains nothing, 0 to 1"
    )
    habit: float = Field(default=0.1, ge=0, le=1, description="weight of a touch in the usual imprint IoU, 0 to 1")
    stay_nats: float = Field(default=8.0, ge=0, description="evidence for a followed mode beside a new one, nats")
    slip_nats: float = Field(default=4.0, ge=0, description="evidence for a mode that slipped beside a new one, nats")
    slip_mm: float = Field(default=2.0, ge=0, description="standard deviation of a slip along each axis, mm")
    slip_deg: float = Field(default=8.6, ge=0, description="standard deviation of a slip about each axis, degrees")
    slips: int = Field(default=64, ge=1, description="slipped poses that are tried")
    near_mm: float = Field(default=0.5, gt=0, description="residuals beyond this are mistrusted at first, mm")
    iterations: int = Field(default=6, ge=2, description="steps of registration from a predicted pose")
