"""Trackers in the image and in the world put together from Stone Soup's components."""

# mypy: disable-error-code="import-untyped"

from collections.abc import Callable, Iterable, Iterator, MutableSet
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import lru_cache
from math import exp, log, pi, sqrt
from operator import neg
from typing import Any

import numpy as np
from scipy.stats import chi2, norm
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
from stonesoup.types.detection import Detection, MissedDetection
from stonesoup.types.hypothesis import SingleDistanceHypothesis, SingleHypothesis, SingleProbabilityHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.prediction import GaussianMeasurementPrediction
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.types.update import GaussianStateUpdate, Update
from stonesoup.updater.kalman import ExtendedKalmanUpdater, KalmanUpdater

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.boxes import centre_form, corner_form
from modsim3d.geometry.camera import Camera
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame
from modsim3d.tracking.trackers.world_interface import AisReport, WorldFacts, WorldFrame, WorldStep, WorldTrackedStep

START = datetime(2000, 1, 1)
_STATE = 6  # x, its rate, y, its rate, width, height
_MEASURED = (0, 2, 4, 5)
_MAX_BOX_SHARE = 0.25  # of the image's width and height: sizes of false positives are taken to go up to it
_MIN_SIDE_PX = 1.0


class _OrderedSet(MutableSet[Any]):
    """A set in order of insertion: Stone Soup's sets are in order of memory addresses, which differ between runs."""

    def __init__(self, items: Iterable[Any] = ()) -> None:
        self._items = dict.fromkeys(items)

    def __contains__(self, item: object) -> bool:
        return item in self._items

    def __iter__(self) -> Iterator[Any]:
        return iter(list(self._items))

    def __len__(self) -> int:
        return len(self._items)

    def add(self, value: Any) -> None:
        self._items[value] = None

    def discard(self, value: Any) -> None:
        self._items.pop(value, None)


def row_of(detection: Any) -> int:
    """Row in its frame of a detection, or of the last detection of a track."""
    return int(detection.metadata["row"])


class _Starter(SimpleMeasurementInitiator):  # type: ignore[misc]
    """Starts tracks in order of the detections' rows."""

    def initiate(self, detections: Iterable[Any], timestamp: datetime, **kwargs: Any) -> _OrderedSet:
        return _OrderedSet(
            track
            for detection in sorted(detections, key=row_of)
            for track in super(_Starter, self).initiate([detection], timestamp)
        )


class _Confirmer(MultiMeasurementInitiator):  # type: ignore[misc]
    """Confirms tracks in order of the detections' rows."""

    def initiate(self, detections: Iterable[Any], timestamp: datetime, **kwargs: Any) -> _OrderedSet:
        left = _OrderedSet(sorted(detections, key=row_of))
        return _OrderedSet(sorted(super().initiate(left, timestamp, **kwargs), key=row_of))


class _LossDeleter(UpdateTimeDeleter):  # type: ignore[misc]
    """Deletes the same tracks, without a look at all their states."""

    def check_for_deletion(self, track: Any, timestamp: datetime | None = None, **_: Any) -> bool:
        age: timedelta = (timestamp or track.timestamp) - last_update(track)
        return age > self.time_since_update  # type: ignore[no-any-return]


def assembled(settings: Any, starter: Any, updater: Any, nearest: Any, joint: Any | None) -> Any:
    """Stone Soup's tracker, with tracks in order. New tracks are confirmed by the hypotheses of `nearest`; confirmed
    ones are followed by the same, or by the joint associator."""
    associator = GNNWith2DAssignment(nearest)
    confirming = _Confirmer(
        prior_state=None,
        deleter=_LossDeleter(timedelta(seconds=settings.tentative_s)),
        data_associator=associator,
        updater=updater,
        min_points=settings.minimum_detections,
        initiator=starter,
    )
    confirming.holding_tracks = _OrderedSet()
    lost = _LossDeleter(timedelta(seconds=settings.lost_s))
    if joint is None:
        tracker = MultiTargetTracker(confirming, lost, None, associator, updater)
    else:
        tracker = MultiTargetMixtureTracker(confirming, lost, None, joint, updater)
    tracker._tracks = _OrderedSet()
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
        _, tracks = self._tracker.update_tracker(time, _OrderedSet(self._detections(frame, time)))
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
    places = width * height * (width * _MAX_BOX_SHARE) * (height * _MAX_BOX_SHARE)
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


_PLACE, _RATE = [0, 2], [1, 3]  # of w1 and w2 in the state
_ORDER = _PLACE + _RATE
_MIN_RANGE_M, _MIN_HEIGHT_M = 1.0, 0.1
_QUANTILES = norm.ppf((np.arange(25) + 0.5) / 25)
_AIS_PER_M2 = 1e-6  # reports of vessels that no track follows


@dataclass(frozen=True, eq=False)
class _View:
    """Measurement of bearing, from a direction on, and of inverse range, as Stone Soup's updaters call it."""

    camera_m: Array  # w1 and w2, (2,)
    towards_rad: float  # direction that bearings are measured from: none is then near ±π
    waterline_m: float  # the centre of a vessel lies that far behind its waterline

    def function(self, state: Any, **_: Any) -> Any:
        """Bearing and inverse range of states (4, n), shape (2, n)."""
        w1, w2 = np.asarray(state.state_vector, dtype=np.float64)[_PLACE] - self.camera_m[:, None]
        bearing = (np.arctan2(w2, w1) - self.towards_rad + pi) % (2 * pi) - pi
        inverse = 1 / np.maximum(np.hypot(w1, w2) - self.waterline_m, _MIN_RANGE_M)
        return np.stack([bearing, inverse]).view(type(state.state_vector))

    def jacobian(self, state: Any, **_: Any) -> Array:
        """Derivatives of the same by the state, shape (2, 4)."""
        w1, w2 = np.asarray(state.state_vector, dtype=np.float64)[_PLACE, 0] - self.camera_m
        away = max(float(np.hypot(w1, w2)), _MIN_RANGE_M)
        short = max(away - self.waterline_m, _MIN_RANGE_M) ** 2 * away
        return np.array([[-w2 / away**2, 0, w1 / away**2, 0], [-w1 / short, 0, -w2 / short, 0]])


@dataclass(frozen=True, eq=False)
class _Measurements:
    """Measurements at one time: m rows of two coordinates, or of the first alone."""

    model: Any
    value: Array  # (m, 2)
    noise: Array  # (m, 2, 2)
    alone: Mask  # whether only the first coordinate is measured, (m,)
    log_density: Array  # logarithm of the density of false ones in the first coordinate alone, and in both
    starts: Mask  # whether it may start a track, (m,)

    def detections(self, time: datetime) -> Iterator[Any]:
        """Detections of Stone Soup, each with the number of its row."""
        for row, (value, alone) in enumerate(zip(self.value, self.alone, strict=True)):
            yield Detection(value[: 1 if alone else 2, None], timestamp=time, metadata={"row": row})


class _Hypotheses:
    """Hypotheses of a track and the measurements in its gate, with their likelihood over the density of false ones. The
    measurement that a track expects is worked out once for all of them."""

    measurements: _Measurements  # at this time

    def __init__(self, settings: Any, predictor: Any, updater: Any, joint: bool) -> None:
        """Weights are distances −log weight, of which an assignment makes the most likely one; or, for joint
        association, they stand for probabilities, which are divided by that of no detection later."""
        self._predictor, self._updater = predictor, updater
        self._kind: Any = SingleProbabilityHypothesis if joint else SingleDistanceHypothesis
        self._score: Callable[[float], float] = exp if joint else neg
        self._gates = chi2.ppf(settings.gate_probability, [2, 1])
        self._log_detected = log(settings.detection_probability)
        self._log_missed = log(1 - settings.detection_probability * settings.gate_probability)

    def hypothesise(self, track: Any, detections: Iterable[Any], timestamp: datetime, **_: Any) -> Any:
        weighted = self._weighted(track, list(detections), timestamp)
        return MultipleHypothesis([self._kind(a, b, self._score(weight), c) for a, b, weight, c in weighted])

    def _weighted(self, track: Any, every: list[Any], time: datetime) -> Iterator[tuple[Any, Any, float, Any]]:
        """Prediction, detection, logarithm of the weight and expected measurement of each hypothesis."""
        prediction = self._predictor.predict(track, timestamp=time)
        yield prediction, MissedDetection(timestamp=time), self._log_missed, None
        if not every:
            return
        given, rows = self.measurements, [row_of(detection) for detection in every]
        expected = self._updater.predict_measurement(prediction, given.model, measurement_noise=False)
        off = given.value[rows] - np.asarray(expected.state_vector, dtype=np.float64).ravel()
        spread, alone = np.asarray(expected.covar, dtype=np.float64) + given.noise[rows], given.alone[rows]
        (aa, ab), (_, bb) = np.moveaxis(spread, 0, -1)
        determinant = np.where(alone, aa, aa * bb - ab**2)
        both = (bb * off[:, 0] ** 2 - 2 * ab * off[:, 0] * off[:, 1] + aa * off[:, 1] ** 2) / determinant
        squared = np.where(alone, off[:, 0] ** 2 / aa, both)
        size = np.where(alone, 1, 2)
        weight = self._log_detected - (squared + np.log(determinant) + size * log(2 * pi)) / 2
        weight -= given.log_density[size - 1]
        for at in np.flatnonzero(squared <= self._gates[alone.astype(np.int64)]).tolist():
            part = slice(0, int(size[at]))
            mean, cross = expected.state_vector[part], expected.cross_covar[:, part]
            measured = GaussianMeasurementPrediction(mean, spread[at, part, part], timestamp=time, cross_covar=cross)
            yield prediction, every[at], float(weight[at]), measured


class _WorldStarter:
    """Starts tracks in order of the rows, where the ray through the foot meets the sea."""

    measurements: _Measurements

    def __init__(self, settings: Any) -> None:
        self._settings = settings

    def initiate(self, detections: Iterable[Any], timestamp: datetime, **_: Any) -> _OrderedSet:
        given, tracks = self.measurements, _OrderedSet()
        for detection in sorted(detections, key=row_of):
            row = row_of(detection)
            if given.starts[row]:
                mean, covariance = self._state(given.model, given.value[row], given.noise[row])
                start = SingleHypothesis(None, detection)
                tracks.add(Track([GaussianStateUpdate(mean, covariance, start, timestamp=timestamp)]))
        return tracks

    def _state(self, view: _View, value: Array, noise: Array) -> tuple[Array, Array]:
        """Mean (4, 1) and covariance of a vessel at rest as far as is known. The moments of its range are those of
        1/ρ, with ρ normal and no vessel beyond `farthest_m`."""
        settings, bearing = self._settings, value[0] + view.towards_rad
        inverse = np.maximum(value[1] + sqrt(noise[1, 1]) * _QUANTILES, 1 / settings.farthest_m)
        away, variance = np.mean(1 / inverse) + view.waterline_m, np.var(1 / inverse)
        along = np.array([np.cos(bearing), np.sin(bearing)])
        across = np.array([-along[1], along[0]])
        mean, covariance = np.zeros((4, 1)), np.zeros((4, 4))
        mean[_PLACE, 0] = view.camera_m + away * along
        beside = (away**2 + variance) * noise[0, 0]
        covariance[np.ix_(_PLACE, _PLACE)] = variance * np.outer(along, along) + beside * np.outer(across, across)
        covariance[_RATE, _RATE] = settings.speed_sigma_m_s**2
        return mean, covariance


def _once_a_time(matrix: Callable[..., Any]) -> Callable[..., Any]:
    """A matrix of a model of motion, made once for all tracks that are predicted over the same time."""
    made = lru_cache(lambda time_interval: matrix(time_interval=time_interval))
    return lambda time_interval, **_: made(time_interval)


class WorldFilter:
    """A tracker of positions and velocities on the sea, from the frames of all cameras and the reports of AIS."""

    def __init__(self, settings: Any, facts: WorldFacts, joint: bool) -> None:
        """Put the components together, by the settings of `stone_soup.StoneSoupWorld`, which imports this file when it
        is used. `joint` says whether detections are associated jointly."""
        self._settings, self._numbers = settings, dict[Any, int]()
        self._cameras = {camera.name: camera for camera in facts.cameras}
        moves = ConstantVelocity(settings.acceleration_density_m2_s3)
        motion = CombinedLinearGaussianTransitionModel([moves, moves])
        motion.matrix, motion.covar = _once_a_time(motion.matrix), _once_a_time(motion.covar)
        predictor = KalmanPredictor(motion)
        updater = ExtendedKalmanUpdater(None)
        nearest, jointly = (_Hypotheses(settings, predictor, updater, flag) for flag in (False, True))
        starter = _WorldStarter(settings)
        self._readers = (nearest, jointly, starter)
        self._tracker = assembled(settings, starter, updater, nearest, JPDAwithLBP(jointly) if joint else None)

    def step(self, step: WorldStep) -> WorldTrackedStep:
        """The tracks after all that arrived at a step."""
        time = START + timedelta(seconds=step.time_s)
        placed = [report for report in step.ais if report.position_m is not None and self._settings.ais]
        if placed or not step.frames:
            self._update(time, self._sent(placed, step.time_s))
        for frame in step.frames:
            self._update(time, self._sighted(frame))
        return self._tracks(time)

    def _update(self, time: datetime, measurements: _Measurements) -> None:
        for reader in self._readers:
            reader.measurements = measurements
        self._tracker.update_tracker(time, _OrderedSet(measurements.detections(time)))

    def _sighted(self, frame: WorldFrame) -> _Measurements:
        settings, places = self._settings, frame.located
        rows = np.flatnonzero(~np.isnan(places.bearing_rad))
        bearing, inverse = places.bearing_rad[rows], places.inverse_range_per_m[rows]
        std, alone = places.inverse_range_std_per_m[rows], np.isnan(inverse)
        towards = float(np.angle(np.exp(1j * bearing).sum()))
        noise = np.empty((len(rows), 2, 2))
        noise[:, 0, 0], noise[:, 1, 1] = places.bearing_std_rad[rows] ** 2, np.where(alone, 1, std**2)
        noise[:, 0, 1] = noise[:, 1, 0] = np.where(alone, 0, places.covariance_rad_per_m[rows])
        noise *= settings.error_scale**2
        nearness = np.clip(np.where(alone, 0, inverse), 1 / settings.farthest_m, 1 / _MIN_RANGE_M)
        noise[:, 0, 0] += (settings.extent_m * nearness) ** 2
        noise[:, 1, 1] += (settings.extent_m * nearness**2) ** 2
        near = std <= settings.start_error * inverse
        return _Measurements(
            model=_View(frame.position_m[:2], towards, settings.waterline_m),
            value=np.stack([(bearing - towards + pi) % (2 * pi) - pi, np.where(alone, 0, inverse)], axis=-1),
            noise=noise,
            alone=alone,
            log_density=_log_density(self._cameras[frame.camera], frame.position_m[2], settings.false_alarms_per_frame),
            starts=near & (frame.sensed.confidence[rows] >= settings.start_confidence),
        )

    def _sent(self, reports: list[AisReport], time_s: float) -> _Measurements:
        """Positions that were sent, brought to the time by their speed."""
        settings, count = self._settings, len(reports)
        age_s = np.array([time_s - (report.measured_s or 0.0) for report in reports])
        places, speeds = np.full((2, count, 2), np.nan)
        for row, report in enumerate(reports):
            places[row], speeds[row] = report.position_m, np.nan if report.velocity_m_s is None else report.velocity_m_s
        variance = settings.ais_std_m**2 + settings.acceleration_density_m2_s3 * age_s**3 / 3
        variance += np.isnan(speeds[:, 0]) * (settings.speed_sigma_m_s * age_s) ** 2
        return _Measurements(
            model=LinearGaussian(4, _PLACE, np.eye(2)),
            value=places + age_s[:, None] * np.nan_to_num(speeds),
            noise=variance[:, None, None] * np.eye(2),
            alone=np.zeros(count, dtype=bool),
            log_density=np.log([_AIS_PER_M2, _AIS_PER_M2]),
            starts=np.zeros(count, dtype=bool),
        )

    def _tracks(self, time: datetime) -> WorldTrackedStep:
        settings, shown = self._settings, []
        for track in self._tracker.tracks:
            self._numbers.setdefault(track.id, len(self._numbers))
            seen = time - last_update(track) <= timedelta(seconds=settings.coast_s)
            if seen and float(np.trace(track.covar[_PLACE][:, _PLACE])) <= settings.greatest_std_m**2:
                shown.append(track)
        if not shown:
            return WorldTrackedStep.empty()
        state = np.array([track.state_vector for track in shown], dtype=np.float64).reshape(-1, 4)
        covariance = np.array([track.covar for track in shown], dtype=np.float64)[:, _ORDER][:, :, _ORDER]
        return WorldTrackedStep(
            np.array([self._numbers[track.id] for track in shown], dtype=np.int64),
            state[:, _PLACE],
            state[:, _RATE],
            (covariance + covariance.swapaxes(1, 2)) / 2,
        )


def _log_density(camera: Camera, height_m: float, per_frame: float) -> Array:
    """Logarithm of the density of false positives in bearing, and in bearing and inverse range: they are taken to lie
    anywhere below the middle of the image."""
    (width, height), (f1, f2) = camera.intrinsics.image_size_px, camera.intrinsics.focal_px
    across, down = 2 * np.arctan(width / (2 * f1)), height / (2 * f2) / max(height_m, _MIN_HEIGHT_M)
    return np.log([per_frame / across, per_frame / (across * down)])
