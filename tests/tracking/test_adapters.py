"""Trackers of other libraries behind our interface."""

import sys
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from pydantic import ValidationError

from modsim3d.core.boxes import centres, corner_form, iou
from modsim3d.core.errors import ModsimError
from modsim3d.plugins import CameraFacts, SensedFrame, TrackedFrame, Tracker
from modsim3d.tracking.trackers.interface import ByteTracker, OcSortTracker, SortTracker
from modsim3d.tracking.trackers.stone_soup import StoneSoupGnn, StoneSoupJpda

BY_IOU = [SortTracker, ByteTracker, OcSortTracker]
STONE_SOUP = [StoneSoupGnn, StoneSoupJpda]
ALL = [*BY_IOU, *STONE_SOUP]

every = pytest.mark.parametrize("tracker", [model() for model in ALL], ids=lambda tracker: type(tracker).__name__)
EACH_MODEL = [model(coast_s=1.0) for model in ALL]
coasting = pytest.mark.parametrize("tracker", EACH_MODEL, ids=lambda tracker: type(tracker).__name__)


def camera(rate_hz: float = 5.0, name: str = "quay") -> CameraFacts:
    return CameraFacts(name, (640, 480), rate_hz, ("boat", "ferry"))


def crossing_px(time_s: float) -> np.ndarray:
    """Two vessels on straight lines that pass each other at 4 s, one above the other by less than their height."""
    return corner_form(np.array([[120.0 + 30 * time_s, 200, 60, 30], [360.0 - 30 * time_s, 222, 60, 30]]))


def sensed(times_s: Sequence[float], noise_px: float = 1.0, empty: Sequence[int] = (), seed: int = 1) -> Iterator:
    """The crossing as a detector sees it, the first vessel a boat and the second a ferry."""
    generator = np.random.default_rng(seed)
    for index, time_s in enumerate(times_s):
        boxes_px = crossing_px(time_s) + generator.normal(0, noise_px, (2, 4))
        kept = slice(0, 0) if index in empty else slice(None)
        yield SensedFrame(time_s, boxes_px[kept], np.array([0, 1])[kept], np.array([0.9, 0.8])[kept])


def times_s(count: int = 40, rate_hz: float = 5.0) -> list[float]:
    return (np.arange(count) / rate_hz).tolist()


def answers(tracker: Tracker, frames: Iterator[SensedFrame], rate_hz: float = 5.0) -> list[TrackedFrame]:
    return list(tracker.follow(frames, camera(rate_hz)))


def followed(answer: TrackedFrame, time_s: float) -> list[int]:
    """The track whose box overlaps each vessel's most, −1 where none does by half."""
    if not len(answer.track):
        return [-1, -1]
    alike = iou(crossing_px(time_s)[:, None], answer.boxes_px)
    best = alike.argmax(axis=1)
    return [int(answer.track[j]) if alike[i, j] > 0.5 else -1 for i, j in enumerate(best)]


@every
def test_crossing_vessels_keep_identities_each_frame_is_answered_at_once_and_odd_ones_are_survived(tracker):
    found = answers(tracker, sensed(times_s()))
    seen = [followed(answer, time_s) for answer, time_s in zip(found, times_s(), strict=True)]
    assert seen[4][0] != seen[4][1] and min(seen[4]) >= 0 and all(pair == seen[4] for pair in seen[4:])
    for answer, tracks in zip(found, seen, strict=True):
        labels = [] if answer.label is None else answer.label.tolist()
        by_track = dict(zip(answer.track.tolist(), labels, strict=True))
        assert [by_track[track] for track in tracks if track >= 0] == [i for i in range(2) if tracks[i] >= 0]
    read = []

    def frames() -> Iterator[SensedFrame]:
        for frame in sensed(times_s(10)):
            read.append(frame)
            yield frame

    for answered, _ in enumerate(tracker.follow(frames(), camera()), start=1):
        assert len(read) == answered
    assert len(read) == 10
    found = answers(tracker, sensed(times_s(6), empty=range(6)))
    assert [(len(answer.track), answer.boxes_px.shape) for answer in found] == [(0, (0, 4))] * 6
    at_edge, equal = np.array([[0.0, 100, 0, 100], [600.0, 440, 640, 480]]), np.tile([100.0, 100, 150, 130], (6, 1))
    for boxes_px, labels in ((at_edge, np.array([0, 1])), (equal, np.zeros(6, int))):
        frames = [SensedFrame(time_s, boxes_px, labels, np.full(len(labels), 0.9)) for time_s in times_s(8)]
        found = answers(tracker, iter(frames))
        assert len(found) == 8 and np.isfinite(np.concatenate([answer.boxes_px for answer in found])).all()


def check_kept(found: list[TrackedFrame], times: Sequence[float], since: int) -> None:
    """The last frame has the vessels on the tracks that they had in an earlier one."""
    first, last = (followed(found[index], times[index]) for index in (since, -1))
    assert len(found) == len(times) and first == last and min(last) >= 0


@every
def test_identities_outlive_short_gaps_and_unequal_steps(tracker):
    found = answers(tracker, sensed(times_s(20), empty=range(8, 10)))
    check_kept(found, times_s(20), 7)
    if type(tracker) in BY_IOU:  # the library reports no track without a detection
        assert [len(answer.track) for answer in found[7:10]] == [2, 0, 0]
    short, times = tracker.model_copy(update={"lost_s": 0.5}), times_s(30)
    found = answers(short, sensed(times, empty=range(8, 13)))
    assert not set(followed(found[-1], times[-1])) & set(followed(found[7], times[7]))
    unequal = np.cumsum(np.tile([0.1, 0.3, 0.2, 0.2], 10)).tolist()
    check_kept(answers(tracker, sensed(unequal)), unequal, 8)
    short, slow = tracker.model_copy(update={"lost_s": 0.5, "tentative_s": 0.5}), times_s(12, rate_hz=1.25)
    check_kept(answers(short, sensed(slow), rate_hz=1.25), slow, 6)


@coasting
def test_a_coasting_track_stays_on_its_vessel_no_longer_than_asked(tracker: Tracker) -> None:
    found = answers(tracker, sensed(times_s(30), noise_px=0.3, empty=range(12, 30)))
    before = followed(found[11], times_s(30)[11])
    for index in range(12, 15):
        assert followed(found[index], times_s(30)[index]) == before
        assert np.isnan(found[index].confidence).all()
    assert [len(answer.track) for answer in found[12:19]] == [2, 2, 2, 2, 2, 0, 0]


@every
def test_two_cameras_may_be_tracked_in_turn_and_the_same_detections_give_the_same_tracks(tracker: Tracker) -> None:
    alone = answers(tracker, sensed(times_s(20), noise_px=6, empty=[7]))
    one, other = (tracker.follow(sensed(times_s(20), 6, [7], seed), camera()) for seed in (1, 2))
    for expected, got, _ in zip(alone, one, other, strict=True):
        for name in ("track", "boxes_px", "label", "confidence", "covariance_px2"):
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    for name in ("quay", "bow"):  # identities start again in another camera
        *_, last = tracker.follow(sensed(times_s(10)), camera(name=name))
        assert set(last.track.tolist()) == {0, 1}


@pytest.mark.parametrize("model", BY_IOU)
def test_the_box_of_a_track_is_its_detection_or_lies_near_it_where_it_is_filtered(model: type[Tracker]) -> None:
    for tracker, least, most in ((model(), 0, 0), (model(boxes="filtered"), 1e-9, 12)):
        for answer, frame in zip(answers(tracker, sensed(times_s(15))), sensed(times_s(15)), strict=True):
            for box_px in answer.boxes_px:
                assert least <= np.abs(frame.boxes_px - box_px).max(axis=1).min() <= most


@pytest.mark.parametrize("model", STONE_SOUP)
def test_filtered_centres_are_closer_to_the_truth_and_their_covariance_grows_while_a_track_coasts(model):
    times = times_s(60)
    tracker, frames = model(acceleration_density_px2_s3=1.0), list(sensed(times, noise_px=5))
    squares = np.zeros(2)
    for answer, frame, time_s in list(zip(answers(tracker, iter(frames)), frames, times, strict=True))[20:]:
        for index, track in enumerate(followed(answer, time_s)):
            truth = crossing_px(time_s)[index]
            box = answer.boxes_px[answer.track == track][0] if track >= 0 else frame.boxes_px[index]
            for place, each in enumerate((box, frame.boxes_px[index])):
                squares[place] += ((centres(each) - centres(truth)) ** 2).sum()
    assert squares[0] < 0.7 * squares[1]
    found = answers(model(), sensed(times_s(15), empty=range(11, 15)))
    variances = [answer.covariance_px2[answer.track == 0][0] for answer in found[10:15]]
    assert all(np.allclose(each, each.T) and np.linalg.eigvalsh(each).min() > 0 for each in variances)
    assert np.all(np.diff([np.trace(each) for each in variances]) > 0)


@every
def test_a_failure_of_the_library_names_camera_and_time_and_a_missing_one_how_to_install_it(tracker, monkeypatch):
    broken = SensedFrame(0.4, np.full((1, 4), np.nan), np.array([0]), np.array([0.9]))
    with pytest.raises(ModsimError, match=r"\w+ failed in camera 'quay' at 0\.4 s"):
        answers(tracker, iter([*sensed([0.0, 0.2]), broken]))
    monkeypatch.delitem(sys.modules, "modsim3d.tracking.trackers.stone_soup_parts", raising=False)
    for library in ("trackers", "stonesoup"):
        for name in [each for each in sys.modules if each.split(".")[0] == library]:
            monkeypatch.setitem(sys.modules, name, None)
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ModsimError, match=r'pip install "modsim3d\[trackers\]"'):
        answers(tracker, sensed([0.0]))


OUT_OF_RANGE: list[tuple[type[Tracker], dict[str, object]]] = [
    *((model, {"lost_s": value}) for model in ALL for value in (-1.0, float("nan"))),
    *((model, {"coast_s": "long"}) for model in ALL),
    *((model, {"lost_frames": 3}) for model in ALL),
    (SortTracker, {"minimum_iou_threshold": 1.5}),
    (ByteTracker, {"track_activation_threshold": -0.1}),
    (OcSortTracker, {"delta_t": 0}),
    (StoneSoupGnn, {"gate_probability": 1.0}),
    (StoneSoupGnn, {"centre_sigma_px": 0.0}),
    (StoneSoupJpda, {"false_alarms_per_frame": 0.0}),
]


@pytest.mark.parametrize(("model", "settings"), OUT_OF_RANGE, ids=str)
def test_settings_out_of_range_are_refused(model: type[Tracker], settings: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        model.model_validate(settings)
