"""All images of a replay together: one pose of an object at rest, or a track."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tactile_loc import Localizer, PoseMetric, Verdict
from tactile_loc.core.runtime.errors import FrameError, NoContactError, RecordingError, TouchError
from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about
from tactile_loc.tracking.frame_fusion import fuse_frames, measure_scatter_m, track_frames
from tactile_loc.tracking.replay import ReplayedFrame, ReplayFrame

T_BASE_OBJECT = make_transform(rotation_about([1, 2, 3], 0.7), [0.4, -0.1, 0.2])
COUNT = 5


@dataclass
class Images:
    """A source of given frames."""

    localizer: Localizer
    frames: list[ReplayFrame]
    has_base: bool = True
    about: str = "images of a test"

    def describe(self) -> dict:
        return {}

    def read_frames(self, first: int = 0) -> Iterator[ReplayFrame]:
        yield from self.frames[first:]


@pytest.fixture(scope="module")
def frames(localizer) -> list[ReplayFrame]:
    """Touches of an object at rest, by a sensor that moves."""
    found = []
    for number, touch in enumerate(localizer.simulate(COUNT, seed=1)):
        T = T_BASE_OBJECT @ invert(touch.T_sensor_object)
        frame = ReplayFrame(number, number * 1_000_000_000, number, "base", f"{number}.npz", T)
        found.append(replace(frame, touch=replace(touch, T_base_sensor=T)))
    return found


def add(frames: list[ReplayFrame], **changes) -> list[ReplayFrame]:
    """Return the frames and a changed copy of the last frame."""
    return [*frames, replace(frames[-1], number=len(frames), **changes)]


def off_m(localizer: Localizer, T: np.ndarray) -> float:
    return float(PoseMetric(localizer.object).symmetric_distance(T[None], T_BASE_OBJECT[None])[0])


def test_an_object_at_rest_gets_one_pose_from_all_touches(localizer, frames):
    untouched = add(frames, touch=None, problem=NoContactError("nothing"))
    rest, records = fuse_frames(Images(localizer, add(untouched, touch=None, problem=TouchError("damaged"))))
    assert off_m(localizer, rest.T_base_object) < 1e-3
    assert rest.explained == 1.0
    assert rest.verdict is rest.localization.verdict
    assert rest.numbers == tuple(range(COUNT))
    assert np.linalg.eigvalsh(rest.covariance).min() > 0
    verdicts = [record.located.verdict for record in records]
    assert verdicts == [*[rest.verdict] * COUNT, Verdict.NO_CONTACT, None]
    for record in records[:-1]:
        np.testing.assert_allclose(record.T_frame_object, rest.T_base_object, atol=1e-9)
        np.testing.assert_allclose(record.located.covariance, rest.covariance, atol=1e-12)
    assert measure_scatter_m(records) < 1e-9
    assert (records[-2].located.says, records[-1].located.says) == ("nothing", "damaged")
    assert records[-1].T_frame_object is None


def test_a_touch_that_the_pose_does_not_explain_is_a_poor_fit(localizer, frames):
    rest, _ = fuse_frames(Images(localizer, frames))
    least = localizer.config.tracker.least_iou
    assert rest.view_frame(frames[0], least - 0.01).verdict is Verdict.POOR_FIT
    assert rest.view_frame(frames[0], least + 0.01).verdict is rest.verdict
    moved = replace(rest, imprint_ious=np.array([0.9, 0.9, 0.1, 0.1]))
    assert moved.explained == 0.5
    assert moved.verdict is Verdict.POOR_FIT


def test_images_are_used_together_only_with_sensor_poses(localizer, frames):
    source = Images(localizer, frames, has_base=False)
    for use in (fuse_frames, lambda source: next(track_frames(source))):
        with pytest.raises(FrameError):
            use(source)
    unknown = [replace(frame, T_base_sensor=None, problem=FrameError("unknown")) for frame in frames]
    with pytest.raises(RecordingError, match="unknown"):
        fuse_frames(Images(localizer, unknown))
    assert [record.located.verdict for record in track_frames(Images(localizer, unknown))] == [None] * COUNT


def test_the_most_frequent_reason_is_given_if_no_image_is_a_touch(localizer, frames):
    refused = [replace(frame, touch=None, problem=TouchError("depths up to 1 m")) for frame in frames]
    refused[0] = replace(refused[0], problem=TouchError("damaged"))
    with pytest.raises(RecordingError, match="depths up to 1 m"):
        fuse_frames(Images(localizer, refused))
    empty = [replace(frame, touch=None, problem=NoContactError("nothing")) for frame in frames]
    with pytest.raises(RecordingError) as caught:
        fuse_frames(Images(localizer, empty))
    assert "nothing" not in str(caught.value)


def test_a_track_predicts_without_contact_and_skips_refused_images(localizer, frames):
    still = [replace(frames[0], number=k, stamp_ns=k * 10_000_000) for k in range(2)]
    some = add(still, touch=None, problem=NoContactError("nothing"))
    some = add(some, problem=TouchError("damaged"), touch=None)
    some = [*some, replace(still[0], number=4, stamp_ns=5_000_000)]  # the clock is set back
    at_once = localizer.config.tracker.model_copy(update={"latency_s": 0})
    config = localizer.config.model_copy(update={"tracker": at_once})
    records = list(track_frames(Images(Localizer(config, localizer.object, localizer.store), some)))
    verdicts = [record.located.verdict for record in records]
    assert verdicts[2:4] == [Verdict.NO_CONTACT, None]
    assert verdicts[1] is localizer.localize(frames[0].touch).verdict is verdicts[4]
    assert [record.T_frame_object is not None for record in records] == [True, True, True, False, True]
    np.testing.assert_allclose(records[2].T_frame_object, records[1].T_frame_object, atol=1e-3)
    assert records[2].located.says == "nothing"


def test_the_scatter_is_that_of_located_origins(frames, localizer):
    rest, records = fuse_frames(Images(localizer, frames[:1]))
    found = rest.view_frame(frames[0], 0.9)
    moved = [ReplayedFrame.of(frames[0], found.view_from(make_translation([x, 0, 0]))) for x in (0.0, 4e-3)]
    assert measure_scatter_m(moved) == pytest.approx(2e-3)
    assert measure_scatter_m(records) == 0.0
