"""Options of the search, the hypotheses and the tracker that a user may tune. Each class is a configuration table.

On the command line, these options are set like a component's options: `-o search.registered=500`, `-o tracker.modes=4`.
"""

from pydantic import BaseModel, ConfigDict, Field

TUNABLE = ("search", "hypotheses", "tracker")
CERTAIN = 0.95  # probability from which a pose is certain


class StrictModel(BaseModel):
    """Values that cannot be changed. Unknown keys, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SearchOptions(StrictModel):
    """Options of the search of a whole object. A rotated place is a place of the object at one yaw."""

    candidates: int = Field(default=1000, ge=1, description="rotated places kept after matching one touch")
    candidates_together: int = Field(default=3000, ge=1, description="the same for each of several touches")
    compared_again: int = Field(
        default=20_000, ge=1, description="rotated places compared again with the surface of an elastic gel"
    )
    pool: int = Field(default=30_000, ge=1, description="rotated places kept before a prior is applied")
    moved: int = Field(default=300, ge=1, description="poses moved by two steps to one touch, then compared with it")
    registered: int = Field(default=150, ge=1, description="poses in coarse registration to one touch")
    moved_together: int = Field(default=100, ge=1, description="poses moved by two steps to several touches")
    registered_together: int = Field(default=60, ge=1, description="poses in coarse registration to several touches")
    registered_widely: int = Field(default=400, ge=1, description="most poses moved, if the first ones fit badly")
    wide_below_iou: float = Field(default=0.8, ge=0, le=1, description="mean imprint IoU below which a fit is bad")
    points: int = Field(default=300, ge=20, description="points of a touch in coarse registration")
    stride: int = Field(default=4, ge=1, description="each step of coarse registration uses one point out of this many")
    iterations: int = Field(default=8, ge=2, description="steps of coarse registration")
    registration_px: int = Field(default=120, ge=16, description="image side of a touch in coarse registration, pixels")
    image_px: int = Field(default=40, ge=16, description="image side for drawing registered poses, pixels")
    apart_mm: float = Field(default=0.5, gt=0, description="least distance between the poses found, mm")
    free_z_mm: float = Field(default=1.0, ge=0, description="free shift along z when drawn for several touches, mm")


class HypothesisOptions(StrictModel):
    """Options that decide which poses are refined, and when two poses count as one hypothesis."""

    mode_radius: float = Field(default=2.0, gt=0, description="poses within this distance are one mode, grid spacings")
    start_radius: float = Field(default=0.25, gt=0, description="least distance between poses to refine, mode radii")
    merge_radius: float = Field(default=0.25, gt=0, description="refined poses this near are merged, mode radii")
    refined: int = Field(default=20, ge=1, description="fewest poses to refine to one touch")
    refined_together: int = Field(default=40, ge=1, description="poses of a listed grid refined to several touches")
    refined_again: int = Field(default=12, ge=1, description="poses refined again without a suspected outlier")
    listed: int = Field(default=400, ge=1, description="most probable poses that each of several touches proposes")
    drawn: int = Field(default=200, ge=1, description="proposed poses that are drawn at low resolution")
    image_px: int = Field(default=40, ge=16, description="image side for drawing proposed poses, pixels")


class TrackerOptions(StrictModel):
    """Options that decide which modes the tracker follows, which touches share a contact, and when it searches."""

    modes: int = Field(default=5, ge=1, description="most modes to follow")
    improbable: float = Field(default=1e-4, gt=0, lt=1, description="modes below this share of the first are dropped")
    common: float = Field(default=0.75, ge=0, lt=1, description="share of a touch's covariance that the next one has")
    apart_mm: float = Field(default=3.0, gt=0, description="sensor motion that reduces this share to 1/e of it, mm")
    touch_noise: float = Field(default=1.6, gt=0, description="factor of a touch's covariance, because noise stays")
    lever_mm: float = Field(default=10.0, gt=0, description="lever arm that converts rotation to motion, mm")
    keyframe_mm: float = Field(default=2.0, gt=0, description="sensor motion between two keyframes, mm")
    keyframes: int = Field(default=5, ge=1, description="most keyframes in one search")
    places: int = Field(default=16, ge=1, description="most touches kept, of which a search chooses its keyframes")
    image_px: int = Field(default=60, ge=16, description="image side for drawing modes, pixels")
    fall_iou: float = Field(default=0.15, ge=0, le=1, description="loss of imprint IoU that contradicts the track")
    clear_percent: float = Field(default=0.5, ge=0, description="least contact of a touch that can end a track, %")
    lost_iou: float = Field(default=0.3, ge=0, le=1, description="loss of imprint IoU that makes a pose a poor fit")
    least_iou: float = Field(default=0.25, ge=0, le=1, description="imprint IoU below which a pose explains nothing")
    confirming: int = Field(default=3, ge=1, description="key touches that end the search, if they are certain")
    latency_s: float = Field(default=0.1, ge=0, description="time from the start of a search to the use of its result")
    check_s: float = Field(default=2.0, ge=0, description="time between checks by touches alone, s; 0: no checks")
    habit: float = Field(default=0.1, ge=0, le=1, description="weight of a touch in the usual imprint IoU, 0 to 1")
    stay_nats: float = Field(default=8.0, ge=0, description="most that a pose far from a slipped one loses, nats")
    slip_surprise: float = Field(default=30.0, gt=0, description="least squared error of a slipped pose, in std")
    slip_iou: float = Field(default=0.05, ge=0, le=1, description="imprint IoU that a slipped pose gains at least")
    slip_mm: float = Field(default=2.0, ge=0, description="standard deviation of a slip along each axis, mm")
    slip_deg: float = Field(default=8.6, ge=0, description="standard deviation of a slip about each axis, degrees")
    slips: int = Field(default=64, ge=1, description="slipped poses to try")
    near_mm: float = Field(default=0.5, gt=0, description="larger residuals count less in the first steps, mm")
    iterations: int = Field(default=6, ge=2, description="registration steps from a predicted pose")
