"""A tracker in the image put together from Stone Soup's components, and what one in the world shares with it."""

# mypy: disable-error-code="import-untyped"

from collections.abc import Iterable, Iterator, MutableSet
from datetime import datetime, timedelta
from math import sqrt
from typing import Any

import numpy as np
from scipy.stats import chi2
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.dataassociator.probability import JPDAwithLBP
from stonesoup.deleter.time import UpdateTimeDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator, SimpleMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity, RandomWalk
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.tracker.simple import MultiTargetMixtureTracker, MultiTargetTracker
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.update import Update
from stonesoup.updater.kalman import KalmanUpdater

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import centre_form, corner_form
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame

START = datetime(2000, 1, 1)
_STATE = 6  # x, its rate, y, its rate, width, height
_MEASURED = (0, 2, 4, 5)
_LARGEST_CLUTTER_SHARE = 0.25  # of the image's width and height: sizes of false detections are taken to go up to it
_MIN_SIDE_PX = 1.0


class OrderedSet(MutableSet[Any]):
    """A set in order of insertion: Stone Soup's sets are in order of memory addresses, which differ between runs."""

    def __init__(self, items: Iterable[Any] = ()) -> None:
        """A set of some items."""
        self._items = dict.fromkeys(items)

    def __contains__(self, item: object) -> bool:
        """Whether it is in the set."""
        return item in self._items

    def __iter__(self) -> Iterator[Any]:
        """The items, first come first."""
        return iter(list(self._items))

    def __len__(self) -> int:
        """Number of items."""
        return len(self._items)

    def add(self, value: Any) -> None:
        """Put an item at the end, unless it is there."""
        self._items[value] = None

    def discard(self, value: Any) -> None:
        """Take an item out, if it is there."""
        self._items.pop(value, None)


def row_of(detection: Any) -> int:
    """Row in its frame of a detection, or of the last detection of a track."""
    return int(detection.metadata["row"])


class _Starter(SimpleMeasurementInitiator):  # type: ignore[misc]
    """Starts tracks in order of the detections' rows."""

    def initiate(self, detections: Iterable[Any], timestamp: datetime, **kwargs: Any) -> OrderedSet:
        return OrderedSet(
            track
            for detection in sorted(detections, key=row_of)
            for track in super(_Starter, self).initiate([detection], timestamp)
        )


class _Confirming(MultiMeasurementInitiator):  # type: ignore[misc]
    """Confirms tracks in order of the detections' rows."""

    def initiate(self, detections: Iterable[Any], timestamp: datetime, **kwargs: Any) -> OrderedSet:
        left = OrderedSet(sorted(detections, key=row_of))
        return OrderedSet(sorted(super().initiate(left, timestamp, **kwargs), key=row_of))


class _Lost(UpdateTimeDeleter):  # type: ignore[misc]
    """Deletes the same tracks, without a look at all their states."""

    def check_for_deletion(self, track: Any, timestamp: datetime | None = None, **_: Any) -> bool:
        age: timedelta = (timestamp or track.timestamp) - last_update(track)
        return age > self.time_since_update  # type: ignore[no-any-return]


def assembled(settings: Any, starter: Any, updater: Any, nearest: Any, joint: Any | None) -> Any:
    """Stone Soup's tracker, with tracks in order. New tracks are confirmed by the hypotheses of `nearest`; confirmed
    ones are followed by the same, or by the joint associator."""
    associator = GNNWith2DAssignment(nearest)
    confirming = _Confirming(
        prior_state=None,
        deleter=_Lost(timedelta(seconds=settings.tentative_s)),
        data_associator=associator,
        updater=updater,
        min_points=settings.minimum_detections,
        initiator=starter,
    )
    confirming.holding_tracks = OrderedSet()
    lost = _Lost(timedelta(seconds=settings.lost_s))
    if joint is None:
        tracker = MultiTargetTracker(confirming, lost, None, associator, updater)
    else:
        tracker = MultiTargetMixtureTracker(confirming, lost, None, joint, updater)
    tracker._tracks = OrderedSet()
    return tracker


class ImageTracker:
    """A tracker of boxes in the images of one camera."""

    def __init__(self, settings: Any, camera: CameraFacts, joint: bool) -> None:
        """Put the components together, by the settings of `stone_soup.StoneSoup`, which imports this file when it is
        used. `joint` says whether detections are associated jointly."""
        self._settings = settings
        self._numbers: dict[Any, int] = {}
        moves = ConstantVelocity(settings.acceleration_density_px2_s3)
        grows = RandomWalk(settings.size_density_px2_s)
        predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([moves, moves, grows, grows]))
        updater = KalmanUpdater(None)
        gate = sqrt(float(chi2.ppf(settings.gate_probability, len(_MEASURED))))
        nearest = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=gate)
        spread = np.zeros(_STATE)
        spread[[1, 3]] = settings.speed_sigma_px_s**2
        starter = _Starter(GaussianState(np.zeros((_STATE, 1)), np.diag(spread)))
        jointly = _joint(settings, camera, predictor, updater) if joint else None
        self._tracker = assembled(settings, starter, updater, nearest, jointly)

    def step(self, frame: SensedFrame) -> TrackedFrame:
        """The tracks in one frame, with or without detections."""
        time = START + timedelta(seconds=frame.time_s)
        _, tracks = self._tracker.update_tracker(time, OrderedSet(self._detections(frame, time)))
        coast = timedelta(seconds=self._settings.coast_s)
        shown = []
        for track in tracks:
            self._numbers.setdefault(track.id, len(self._numbers))
            if time - last_update(track) <= coast:
                shown.append(track)
        if not shown:
            return TrackedFrame.empty()
        state = np.array([track.state_vector for track in shown], dtype=np.float64).reshape(-1, _STATE)
        covariance = np.array([track.covar for track in shown], dtype=np.float64)
        box = state[:, _MEASURED]
        box[:, 2:] = np.maximum(box[:, 2:], _MIN_SIDE_PX)
        seen = [last_update(track) == time for track in shown]
        return TrackedFrame(
            np.array([self._numbers[track.id] for track in shown], dtype=np.int64),
            corner_form(box),
            np.array([track.metadata["label"] for track in shown], dtype=np.int64),
            np.where(seen, [track.metadata["confidence"] for track in shown], np.nan),
            covariance[:, [[0], [2]], [0, 2]],
        )

    def _detections(self, frame: SensedFrame, time: datetime) -> Iterator[Any]:
        boxes = centre_form(frame.boxes_px)
        rows = zip(boxes, self._variances(boxes), frame.label.tolist(), frame.confidence.tolist(), strict=True)
        for row, (box, variance, label, confidence) in enumerate(rows):
            yield Detection(
                box[:, None],
                timestamp=time,
                measurement_model=LinearGaussian(_STATE, _MEASURED, np.diag(variance)),
                metadata={"row": row, "label": label, "confidence": confidence},
            )

    def _variances(self, boxes: Array) -> Array:
        """Variances of the errors of centre x, centre y, width and height of detections, shape (m, 4)."""
        own, size = self._settings, np.maximum(boxes[:, 2:], 0)
        centre = own.centre_sigma_px**2 + (own.centre_sigma_share * size) ** 2
        return np.concatenate([centre, own.size_sigma_px**2 + (own.size_sigma_share * size) ** 2], axis=1)


def _joint(settings: Any, camera: CameraFacts, predictor: Any, updater: Any) -> Any:
    """Joint association by loopy belief propagation (Williams & Lau (2014)). Exact methods take seconds a frame where a
    dozen detections lie in the gates of a dozen tracks."""
    width, height = camera.image_size_px
    places = width * height * (width * _LARGEST_CLUTTER_SHARE) * (height * _LARGEST_CLUTTER_SHARE)
    hypotheses = PDAHypothesiser(
        predictor,
        updater,
        clutter_spatial_density=settings.false_alarms_per_frame / places,
        prob_detect=settings.detection_probability,
        prob_gate=settings.gate_probability,
    )
    return JPDAwithLBP(hypotheses)


def last_update(track: Any) -> datetime:
    """Time at which the last detection was associated with a track."""
    updates = (state for state in reversed(track.states) if isinstance(state, Update) and state.hypothesis)
    time: datetime = next(updates).timestamp
    return time
