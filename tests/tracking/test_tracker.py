"""A track: held while the sensor slides, up to symmetry; lost and found after a jump; predicted without contact."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from message_helpers import naming
from track_settings import SETTINGS

from tactile_loc import Localizer, PoseMetric, RobotTouches, TrackerOptions, Verdict
from tactile_loc.core.geometry.lie import compute_pose_errors, move
from tactile_loc.core.poses.tolerance import measure_shape_distances
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.metrics import compute_nees
from tactile_loc.plugin import ConfigError, TouchError
from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer
from tactile_loc.tracking.key_search import KeySearch
from tactile_loc.tracking.tracked_pose import TrackedPose, TrackTrust
from tactile_loc.tracking.tracker import JUMPED_NATS, MOST_DOUBTS, MOST_WEIGHED, Tracker

SlidingTouches = pytest.importorskip("tactile_loc_benchmark.sliding_touches").SlidingTouches

STD = np.array([5e-4] * 3 + [1e-2] * 3)
MINI = {"name": "gelsight-mini", "image_size_px": [100, 75]}
T_BASE_OBJECT = make_transform(rotation_about([0, 0, 1], 0.5), [0.4, 0.1, 0.05])


@pytest.fixture(scope="module")
def pin(store) -> Localizer:
    return Localizer.create("pin", store=store, **SETTINGS)


@pytest.fixture(scope="module")
def sure(pin):
    """Return two touches of different poses, each located separately, and the results."""
    metric = PoseMetric(pin.object)
    good = []
    for touch in pin.simulate(12, seed=1):
        found = pin.localize(touch)
        off_m = metric.symmetric_distance(found.best.T_sensor_object[None], touch.T_sensor_object[None])[0]
        if off_m < 5e-4 and found.best.probability > 0.95:
            good.append(touch)
        if len(good) == 2:
            return good
    raise AssertionError("too few touches of the pin determine its pose")


@pytest.fixture(scope="module")
def slide(pin):
    errors = {"noise": NOISE["mild"], "sensor_std_m": 1e-4, "sensor_std_rad": 2e-3}
    source = RobotTouches(pin.object, pin.sensor.geometry, ZBufferRenderer(), **errors)
    return SlidingTouches(source).draw_example(80, np.random.default_rng(3))


def started(localizer: Localizer, frames, seed: int = 0) -> Tracker:
    tracker = Tracker(localizer)
    truth = frames[0].T_base_sensor @ frames[0].T_sensor_object
    tracker.start(move(truth, STD * np.random.default_rng(seed).normal(size=6)), np.diag(STD**2))
    return tracker


def off_mm(localizer: Localizer, T: np.ndarray, truth: np.ndarray) -> float:
    return 1e3 * float(PoseMetric(localizer.object).symmetric_distance(T[None], truth[None])[0])


def off_surface_mm(localizer: Localizer, found: TrackedPose, truth: np.ndarray) -> float:
    """Return the shape distance: one noisy touch of the pin leaves turns about its axis open."""
    return 1e3 * float(measure_shape_distances(localizer.object.mesh, found.T_sensor_object[None], truth)[0])


def test_a_slide_is_tracked_and_the_covariance_holds_the_truth(pin, slide):
    tracker = started(pin, slide)
    found = [tracker.update(frame.time_s, frame.touch, frame.T_base_sensor) for frame in slide]
    assert {one.verdict for one in found} == {Verdict.CERTAIN}
    truth = [frame.T_sensor_object for frame in slide]
    errors = [off_mm(pin, one.T_sensor_object, T) for one, T in zip(found, truth, strict=True)]
    assert np.median(errors) < 0.3
    assert errors[-1] < 0.5
    known = [(PoseMetric(pin.object), one.T_sensor_object, one.covariance) for one in found]
    nees = [compute_nees(*one, T) for one, T in zip(known, truth, strict=True)]
    assert np.median(nees) < 16.8  # 99 % of chi-squared; the frames of one slide have similar errors


def at_once(localizer: Localizer, **options: float) -> Localizer:
    """Return a localizer whose trackers finish each search within one frame."""
    options = localizer.config.tracker.model_copy(update={"latency_s": 0, **options})
    config = localizer.config.model_copy(update={"tracker": options})
    made = Localizer(config, localizer.object, localizer.store)
    made.for_sensor(MINI)
    return made


def test_the_first_touch_is_searched_and_found_up_to_symmetry(pin, sure):
    tracker = Tracker(at_once(pin))
    found = tracker.update(0.0, sure[0], np.eye(4))
    assert found.searched
    assert off_mm(pin, found.T_sensor_object, sure[0].T_sensor_object) < 1.0
    assert np.all(np.diff(found.probabilities) <= 0)
    assert found.probabilities.sum() <= 1 + 1e-9
    again = tracker.update(0.01, sure[0], np.eye(4))
    assert not again.searched


def test_a_search_is_spread_over_frames_and_ends_like_one_at_once(pin, sure):
    """At first there is no pose; the pose comes after some frames, with the verdict of the touches located together."""
    spread, whole = Tracker(pin), Tracker(at_once(pin))
    each = [spread.update(0.01 * k, sure[0], np.eye(4)) for k in range(30)]
    found = whole.update(0.0, sure[0], np.eye(4))
    assert each[0].T_sensor_object is None
    assert each[0].verdict is Verdict.NOT_FOUND
    first = next(k for k, one in enumerate(each) if one.T_sensor_object is not None)
    assert first > 0
    assert all(one.searched for one in each[: first + 1])
    assert not each[-1].searched
    assert each[first].verdict is found.verdict is pin.localize(sure[0]).verdict
    assert off_mm(pin, each[first].T_sensor_object, found.T_sensor_object) < 0.1
    assert each[first].probabilities[0] == pytest.approx(found.probabilities[0])


def test_an_object_that_jumps_is_found_again(pin, sure):
    before, after = sure
    tracker = Tracker(at_once(pin))
    for k in range(3):
        found = tracker.update(0.01 * k, before, np.eye(4))
    assert not found.searched
    later = [tracker.update(0.03 + 0.01 * k, after, np.eye(4)) for k in range(3)]
    assert any(one.searched for one in later)
    assert off_mm(pin, later[-1].T_sensor_object, after.T_sensor_object) < 1.0
    assert later[-1].verdict is Verdict.AMBIGUOUS  # one touch may be of another object
    assert not tracker.update(0.06, after, np.eye(4)).searched


def test_a_start_that_explains_no_touch_is_doubted_and_replaced(pin, sure):
    """The start is so wrong that the sensor would not touch the object there."""
    truth, tracker = sure[0].T_sensor_object, Tracker(at_once(pin))
    tracker.start(make_translation([0.0, 0.0, 0.05]) @ truth, np.diag(STD**2))
    found = [tracker.update(0.01 * k, sure[0], np.eye(4)) for k in range(MOST_DOUBTS)]
    assert [one.searched for one in found] == [False] * (MOST_DOUBTS - 1) + [True]
    assert off_mm(pin, found[-1].T_sensor_object, truth) < 1.0


def test_a_pose_that_fits_worse_than_before_a_jump_is_at_most_ambiguous(pin, sure):
    """It replaces a track that explains nothing. It may be a pose of another object."""
    before, after = sure
    tracker = Tracker(at_once(pin, fall_iou=0.0))
    tracker.start(before.T_sensor_object, np.diag(STD**2))
    tracker.update(0.0, before, np.eye(4))
    tracker._trust = replace(tracker._trust, usual_iou=1.0)
    found = [tracker.update(0.01 + 0.01 * k, after, np.eye(4)) for k in range(MOST_DOUBTS)]
    assert off_mm(pin, found[-1].T_sensor_object, after.T_sensor_object) < 1.0
    assert found[-1].verdict is Verdict.AMBIGUOUS


def test_a_pose_that_stops_explaining_the_touches_is_a_poor_fit(pin, sure, slide):
    """A touch of another place ends the trust in a pose, and the next good touch restores it."""
    tracker = started(pin, slide)
    for k in range(3):
        held = tracker.update(0.01 * k, slide[k].touch, slide[k].T_base_sensor)
    assert held.verdict is Verdict.CERTAIN
    trust = tracker._trust
    assert trust.judge(True, trust.usual_iou - 0.31, True) is Verdict.POOR_FIT
    assert trust.add_touch(0.1).usual_iou == trust.usual_iou
    assert trust.judge(True, trust.usual_iou - 0.1, True) is Verdict.CERTAIN
    assert trust.judge(False, np.nan, True) is Verdict.NOT_FOUND
    assert trust.judge(True, np.nan, False) is Verdict.NO_CONTACT


def test_touches_of_another_object_are_not_called_certain(pin, store, slide):
    """From the first touch on, the track of the pin knows that something is wrong."""
    head = Localizer.create("head", store=store, **SETTINGS)
    source = RobotTouches(head.object, head.sensor.geometry, ZBufferRenderer(), noise=NOISE["mild"])
    others = SlidingTouches(source).draw_example(12, np.random.default_rng(4))
    tracker, last = started(pin, slide), slide[2]
    for frame in slide[:3]:
        held = tracker.update(frame.time_s, frame.touch, frame.T_base_sensor)
    assert held.verdict is Verdict.CERTAIN
    T_base_new = last.T_base_sensor @ invert(others[0].T_base_sensor)
    others = [(1.0 + one.time_s, one.touch, T_base_new @ one.T_base_sensor) for one in others if one.touch is not None]
    found = [tracker.update(*other) for other in others]
    assert len(found) > 5
    assert Verdict.CERTAIN not in {one.verdict for one in found}


def test_a_pose_is_only_as_certain_as_its_search():
    trust = TrackTrust(TrackerOptions(confirming=2))
    assert trust.settled
    assert trust.judge(True, 0.8, True) is Verdict.CERTAIN
    found = trust.restart(Verdict.AMBIGUOUS, 0.4, 0.8, keys=3)
    assert not found.settled
    assert found.judge(True, 0.8, True) is Verdict.AMBIGUOUS
    assert not trust.restart(Verdict.CERTAIN, 0.95, 0.8, keys=1).settled
    assert trust.restart(Verdict.CERTAIN, 0.95, 0.8, keys=2).settled


def test_modes_share_the_probability_that_the_search_states():
    trust = TrackTrust(TrackerOptions(), probability=0.4)
    p = trust.share(np.array([1.0, 0.5, 0.25]))
    assert p == pytest.approx([0.4, 0.4, 0.2])
    assert TrackTrust(TrackerOptions(), probability=0.9).share(np.array([1.0])) == pytest.approx([0.9])


def show_slip(pin: Localizer, frame, tracker: Tracker) -> tuple[TrackedPose, np.ndarray]:
    """Show a frame 12 times, then a touch of the slipped object; return the tracked pose and the true pose."""
    for k in range(12):
        tracker.update(0.01 * k, frame.touch, frame.T_base_sensor)
    slipped = make_translation([2e-3, 1e-3, 0.0]) @ frame.T_sensor_object
    source = RobotTouches(pin.object, pin.sensor.geometry, ZBufferRenderer())
    touch = source.draw_touch(slipped, frame.touch.indentation_m, "slipped", np.random.default_rng(0))
    return tracker.update(0.12, touch, frame.T_base_sensor), slipped


def test_an_object_that_slips_is_found_nearby(pin, slide):
    """The tracker chooses no other place that would explain the touch equally well."""
    found, slipped = show_slip(pin, slide[0], started(pin, slide))
    assert found.slipped
    assert found.verdict is not Verdict.CERTAIN
    assert off_surface_mm(pin, found, slipped) < 0.4


@pytest.mark.parametrize(("iou", "most_nats"), [(0.9, TrackerOptions().stay_nats), (0.6, JUMPED_NATS)])
def test_a_slip_that_explains_its_touch_worse_than_usual_may_be_a_jump(pin, slide, monkeypatch, iou, most_nats):
    """Then the search favours poses nearby less."""
    tracker = started(pin, slide)
    find = tracker._filter.find_slipped
    monkeypatch.setattr(
        tracker._filter, "find_slipped", lambda *seen: [replace(mode, imprint_iou=iou) for mode in find(*seen)]
    )
    assert show_slip(pin, slide[0], tracker)[0].slipped
    assert tracker._search.prior.most_nats == most_nats


def test_a_slip_that_did_not_happen_is_taken_back(pin, slide):
    """A single touch shows a slip. All later touches show the object where it was."""
    frame, tracker = slide[0], started(pin, slide)
    found, _ = show_slip(pin, frame, tracker)
    assert found.slipped
    later = [tracker.update(0.13 + 0.01 * k, frame.touch, frame.T_base_sensor) for k in range(MOST_WEIGHED)]
    assert later[-1].verdict is Verdict.CERTAIN
    assert off_surface_mm(pin, found, frame.T_sensor_object) > 0.8
    assert off_surface_mm(pin, later[-1], frame.T_sensor_object) < 0.5


def test_the_latest_result_is_there_for_other_threads(pin, slide):
    tracker = started(pin, slide)
    assert tracker.latest() is None
    found = tracker.update(0.0, slide[0].touch, slide[0].T_base_sensor)
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(tracker.latest).result() is found


@pytest.fixture(scope="module")
def fingers(pin):
    """Return the localizer of two sensors, and touches of both of them, of an object at rest in the base frame."""
    mini = pin.for_sensor(MINI)
    touches = [one.simulate(3, seed=7) for one in (pin, mini)]
    frames = (pair for frame in zip(*touches, strict=True) for pair in frame)
    return [replace(touch, T_base_sensor=T_BASE_OBJECT @ invert(touch.T_sensor_object)) for touch in frames]


def test_two_fingers_with_different_sensors_are_tracked_together(pin, fingers):
    left, right = fingers[:2]
    one, two = Tracker(pin), Tracker(pin)
    for tracker in (one, two):
        tracker.start(move(T_BASE_OBJECT, 0.5 * STD), np.diag(STD**2))
    alone, both = one.update(0.0, left), two.update(0.0, [left, right])
    assert both.verdict is Verdict.CERTAIN
    assert off_mm(pin, both.T_base_object, T_BASE_OBJECT) < 0.3
    assert np.linalg.det(both.base_covariance) < np.linalg.det(alone.base_covariance)
    off_m = np.linalg.norm((left.T_base_sensor @ both.T_sensor_object - both.T_base_object)[:3, 3])
    assert off_m < 5e-4, "the poses differ by the error of the sensor's pose only"


def test_fingers_may_lose_contact_and_find_it_again(pin, fingers):
    left, right = fingers[:2]
    tracker = Tracker(pin)
    tracker.start(move(T_BASE_OBJECT, 0.5 * STD), np.diag(STD**2))
    shown = [[left, right], [None, right], [None, None], [left, None], [left, right]]
    found = [tracker.update(0.02 * k, some) for k, some in enumerate(shown)]
    words = [one.verdict for one in found]
    assert words == [Verdict.CERTAIN] * 2 + [Verdict.NO_CONTACT] + [Verdict.CERTAIN] * 2
    assert all(off_mm(pin, one.T_base_object, T_BASE_OBJECT) < 0.3 for one in found)


def test_two_fingers_are_searched_together_from_an_unknown_start(pin, fingers):
    tracker = Tracker(at_once(pin))
    found = tracker.update(0.0, fingers[:2])
    assert found.searched
    assert [key.name for key in tracker._search.touches] == [touch.name for touch in fingers[:2]]
    assert found.verdict is pin.localize(fingers[:2]).verdict


def test_several_fingers_need_the_pose_of_each_sensor(pin, fingers):
    left, right = fingers[:2]
    tracker = Tracker(pin)
    nowhere = replace(right, T_base_sensor=None)
    with pytest.raises(TouchError, match=naming("0.5 s", right.name, "T_base_sensor")):
        tracker.update(0.5, [left, nowhere])
    with pytest.raises(TouchError, match=naming("0.5 s")):
        tracker.update(0.5, [left, right], np.eye(4))


def test_touches_that_are_certain_of_another_pose_end_the_trust_in_a_start(pin, fingers):
    """The check of a track locates key touches without its pose."""
    tracker = Tracker(at_once(pin, check_s=0.1))
    tracker.start(T_BASE_OBJECT, np.diag(STD**2))
    shown = [[fingers[k], fingers[k + 1]] for k in (0, 2, 4)]
    held = [tracker.update(0.02 * k, some) for k, some in enumerate(shown)]
    assert {one.verdict for one in held} == {Verdict.CERTAIN}
    wrong = move(T_BASE_OBJECT, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    located = pin.localize(fingers)
    assert located.verdict is Verdict.CERTAIN
    tracker._modes = [replace(tracker._modes[0], known=replace(tracker._modes[0].known, T_base_object=wrong))]
    tracker._check = KeySearch(tracker.localizer, tuple(fingers))
    tracker._time_s = 0.2
    tracker._check_on()
    assert not tracker._trust.settled
    assert tracker._trust.limit is Verdict.AMBIGUOUS
    assert tracker._search.is_due


def test_a_check_that_agrees_leaves_the_track_as_it_is(pin, fingers):
    tracker = Tracker(at_once(pin, check_s=0.05))
    tracker.start(T_BASE_OBJECT, np.diag(STD**2))
    found = [tracker.update(0.02 * k, fingers[:2]) for k in range(8)]
    assert {one.verdict for one in found} == {Verdict.CERTAIN}
    assert tracker._checked_s > 0.05


def test_the_pose_is_predicted_without_contact_with_growing_covariance(pin, slide):
    tracker = started(pin, slide)
    first = slide[0]
    held = tracker.update(0.0, first.touch, first.T_base_sensor)
    T_base_sensor = first.T_base_sensor @ make_transform(rotation_about([0, 1, 2], 0.3), [0.01, 0.0, -0.03])
    found = tracker.update(0.5, None, T_base_sensor)
    assert found.verdict is Verdict.NO_CONTACT
    assert np.isnan(found.imprint_iou)
    expected = invert(T_base_sensor) @ first.T_base_sensor @ held.T_sensor_object
    off_m = np.linalg.norm(compute_pose_errors(found.T_sensor_object, expected)[:3])
    assert off_m < 1e-4  # except for the error of the sensor pose
    assert np.linalg.eigvalsh(found.covariance).min() > 0
    later = tracker.update(5.0, None, T_base_sensor)
    assert np.trace(later.covariance) > np.trace(found.covariance)


def test_a_track_has_no_pose_before_the_first_touch(pin):
    found = Tracker(pin).update(0.0, None, np.eye(4))
    assert found.verdict is Verdict.NO_CONTACT
    assert found.T_sensor_object is found.covariance is None
    assert len(found.probabilities) == 0


def test_a_repeated_static_touch_does_not_become_certain(pin, slide):
    tracker = started(pin, slide)
    touch, T = slide[0].touch, slide[0].T_base_sensor
    traces = [np.sqrt(np.trace(tracker.update(0.01 * k, touch, T).covariance[:3, :3])) for k in range(60)]
    assert traces[-1] <= traces[0]
    assert traces[-1] > 0.5 * traces[1]


def test_invalid_input_gives_a_one_sentence_error(pin, slide):
    tracker = started(pin, slide)
    touch, T = slide[0].touch, slide[0].T_base_sensor
    nowhere = replace(touch, T_base_sensor=None)
    tracker.update(1.0, touch)
    other = replace(touch, geometry=replace(touch.geometry, fx=2 * touch.geometry.fx))
    for given, words in (
        ((0.5, touch), ("0.5 s", "1 s")),
        ((np.nan, touch), ("nan s", "1 s")),
        ((1.1, nowhere), ("1.1 s", "T_base_sensor")),
        ((1.1, touch, 2.0 * T), ("1.1 s", "rigid")),
        ((1.1, other), ("frame-0000", "gelslim")),
    ):
        with pytest.raises(TouchError, match=naming(*words)):
            tracker.update(*given)
    assert tracker.update(1.2, touch, T).verdict is Verdict.CERTAIN, "a refused frame changed the track"


def test_invalid_poses_covariances_and_creep_are_refused(pin):
    for T, covariance, words in (
        (np.eye(3), np.eye(6), ("T_base_object", "rigid")),
        (np.eye(4), -np.eye(6), ("T_base_object", "(6, 6)")),
    ):
        with pytest.raises(TouchError, match=naming(*words)):
            Tracker(pin).start(T, covariance)
    for creep in (-1e-3, np.nan, np.inf):
        with pytest.raises(ConfigError, match=naming(f"{creep:g} m")):
            Tracker(pin, creep_m=creep)
