"""Interface of trackers: one is given the detections of a camera frame by frame, and answers each with its tracks."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import sizes
from modsim3d.core.errors import ModsimError
from modsim3d.io.validation import NotNegative, Probability, Strict


@dataclass(frozen=True, eq=False)
class CameraFacts:
    """Facts about the camera that a tracker knows.

    Attributes:
        name: Name of the camera.
        image_size_px: Width and height.
        rate_hz: Frames a second, on average.
        labels: Names of the classes.
    """

    name: str
    image_size_px: tuple[int, int]
    rate_hz: float
    labels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SensedFrame:
    """The detections of one frame: m rows, the most confident first; m may be 0.

    Attributes:
        time_s: Time since the scene's first step.
        boxes_px: x_min, y_min, x_max, y_max, shape (m, 4).
        label: Index of the class, shape (m,).
        confidence: From 0 to 1, shape (m,).
    """

    time_s: float
    boxes_px: Array
    label: Indices
    confidence: Array


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """The tracks that a tracker reports in one frame: k rows in any order; k may be 0.

    Attributes:
        track: A number for each track, the same in all frames, shape (k,).
        boxes_px: x_min, y_min, x_max, y_max, shape (k, 4).
        label: Index of the class, shape (k,); None if the tracker says none.
        confidence: Shape (k,); None if the tracker says none.
        covariance_px2: Of x and y of the centre of the box, shape (k, 2, 2); None if the tracker has none.
    """

    track: Indices
    boxes_px: Array
    label: Indices | None = None
    confidence: Array | None = None
    covariance_px2: Array | None = None

    @classmethod
    def empty(cls) -> TrackedFrame:
        """No track."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, 4)))


class Tracker(Strict):
    """A tracker; its fields are its settings, with their defaults.

    A plug-in names a subclass of it under the entry point group `modsim3d.trackers`.
    """

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        """Track the detections of one camera: for each frame, in order of time, one answer before the next is read."""
        raise NotImplementedError


Answer = TypeVar("Answer")


def answers_of(
    library: str, step: Callable[[Any], Answer], frames: Iterable[Any], camera: CameraFacts | None = None
) -> Iterator[Answer]:
    """Answers of a library's tracker to each frame, or each step of all cameras, without its warnings. Raises
    ModsimError if it failed in one."""
    for frame in frames:
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                answer = step(frame)
        except Exception as error:
            where = f"at {frame.time_s:g} s" if camera is None else f"in camera '{camera.name}' at {frame.time_s:g} s"
            raise ModsimError(f"{library} failed {where}: {type(error).__name__}: {error}") from error
        yield answer


_BUFFER_RATE_HZ = 30  # the library counts `lost_track_buffer` in frames of this rate, whatever the camera's
_MIN_PERIODS_KEPT = 1.5  # the library drops lost tracks before it matches: they must outlive the time between frames

FrameCount = Annotated[int, Field(strict=True, ge=1, le=1000)]
Overlap = Annotated[float, Field(strict=True, ge=-1, le=1)]


class _LibraryTracker(Tracker):
    """Base of the three trackers of the library; what one of them adds has the library's name."""

    library_name: ClassVar[str]  # of the class in the library

    lost_s: NotNegative = 2.0  # a track without a detection for longer is dropped: `lost_track_buffer` over 30
    minimum_consecutive_frames: FrameCount = 2  # detections in a row that make a track
    minimum_iou_threshold: Overlap = 0.1  # least overlap of a detection and a track's predicted box, in terms of `iou`
    iou: Literal["iou", "biou", "giou", "diou", "ciou"] = "iou"  # the last three are below 0 for boxes apart
    state_estimator: Literal["xyxy", "xcycsr"] = "xyxy"  # the filter's state: corners, or centre, area and aspect ratio
    boxes: Literal["detected", "filtered"] = "detected"  # of a track with a detection; the library reports the detected
    coast_s: NotNegative = 0.0  # a track without a detection is reported so long, as filtered; the library reports none

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        """Track the detections of one camera. Raises ModsimError without the library, or if it failed in a frame."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tracker = self._library_tracker(camera)
        labels: dict[int, int] = {}
        yield from answers_of(self.library_name, lambda frame: self._step(tracker, frame, labels), frames, camera)

    def _library_tracker(self, camera: CameraFacts) -> Any:
        try:
            import trackers
            from trackers.utils import iou
            from trackers.utils.state_representations import XCYCSRStateEstimator, XYXYStateEstimator
        except ImportError:
            raise ModsimError(
                f'{self.library_name} needs the library trackers: pip install "modsim3d[trackers]"'
            ) from None
        measures = {"iou": iou.IoU, "biou": iou.BIoU, "giou": iou.GIoU, "diou": iou.DIoU, "ciou": iou.CIoU}
        estimators = {"xyxy": XYXYStateEstimator, "xcycsr": XCYCSRStateEstimator}
        kept_s = max(self.lost_s, _MIN_PERIODS_KEPT / camera.rate_hz)
        return getattr(trackers, self.library_name)(
            lost_track_buffer=math.ceil(kept_s * _BUFFER_RATE_HZ - 1e-6),
            frame_rate=camera.rate_hz,
            minimum_consecutive_frames=self.minimum_consecutive_frames,
            minimum_iou_threshold=self.minimum_iou_threshold,
            iou=measures[self.iou](),
            state_estimator_class=estimators[self.state_estimator],
            **{name: getattr(self, name) for name in type(self).model_fields.keys() - _LibraryTracker.model_fields},
        )

    def _step(self, tracker: Any, frame: SensedFrame, labels: dict[int, int]) -> TrackedFrame:
        """The answer to one frame; `labels` has the last label of each track."""
        import supervision

        answer = tracker.update(
            supervision.Detections(
                xyxy=np.array(frame.boxes_px, dtype=np.float64).reshape(-1, 4),
                confidence=np.array(frame.confidence, dtype=np.float64),
                class_id=np.array(frame.label, dtype=np.int64),
            ),
            timestamp=frame.time_s,
        )
        valid = np.asarray(answer.tracker_id) >= 0  # -1: no track, or one that is not yet confirmed
        if not valid.any():
            seen = TrackedFrame(np.empty(0, np.int64), np.empty((0, 4)), np.empty(0, np.int64), np.empty(0))
        else:
            columns = (answer.tracker_id, answer.xyxy, answer.class_id, answer.confidence)
            seen = TrackedFrame(*(np.asarray(column)[valid] for column in columns))
        assert seen.label is not None
        labels.update(zip(seen.track.tolist(), seen.label.tolist(), strict=True))
        if self.boxes == "detected" and self.coast_s == 0:
            return seen
        return self._with_states(seen, tracker.tracks, labels)

    def _with_states(self, seen: TrackedFrame, tracklets: list[Any], labels: dict[int, int]) -> TrackedFrame:
        """The answer with boxes of the filter, and with tracks that were lost a short time ago."""
        states: dict[int, Array] = {tracklet.tracker_id: tracklet.get_state_bbox() for tracklet in tracklets}
        boxes_px = seen.boxes_px
        if self.boxes == "filtered":
            filtered = np.array([states[track] for track in seen.track.tolist()]).reshape(-1, 4)
            whole = (sizes(filtered) > 0).all(axis=1, keepdims=True)  # a filter of corners may cross them
            boxes_px = np.where(whole, filtered, boxes_px)
        away = [
            tracklet.tracker_id
            for tracklet in tracklets
            if tracklet.tracker_id in labels
            and tracklet.tracker_id not in seen.track
            and tracklet.time_since_update_seconds <= self.coast_s + 1e-6
            and (sizes(states[tracklet.tracker_id]) > 0).all()
        ]
        assert seen.label is not None
        assert seen.confidence is not None
        lost: Indices = np.array(away, dtype=np.int64)
        return TrackedFrame(
            np.append(seen.track, lost),
            np.concatenate([boxes_px, np.array([states[track] for track in away]).reshape(-1, 4)]),
            np.append(seen.label, np.array([labels[track] for track in away], dtype=np.int64)),
            np.append(seen.confidence, np.full(len(away), np.nan)),
        )


class SortTracker(_LibraryTracker):
    """SORT (Bewley et al. (2016))."""

    library_name: ClassVar[str] = "SORTTracker"

    track_activation_threshold: Probability = 0.25  # least confidence of a detection that starts a track


class ByteTracker(_LibraryTracker):
    """ByteTrack (Zhang et al. (2022))."""

    library_name: ClassVar[str] = "ByteTrackTracker"

    # Least confidence of a detection that starts a track; the library's 0.7 starts few where boats have a mean
    # confidence of 0.67.
    track_activation_threshold: Probability = 0.5
    high_conf_det_threshold: Probability = 0.5  # detections from here on are matched first, and only they start tracks


class OcSortTracker(_LibraryTracker):
    """OC-SORT (Cao et al. (2023))."""

    library_name: ClassVar[str] = "OCSORTTracker"

    state_estimator: Literal["xyxy", "xcycsr"] = "xcycsr"
    high_conf_det_threshold: Probability = 0.3  # detections of less confidence are not used
    direction_consistency_weight: NotNegative = 0.2  # of the direction of motion beside the overlap
    delta_t: FrameCount = 3  # frames back over which the direction is taken
