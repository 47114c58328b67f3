"""Runs a tracker over the frames of cameras, one after the other, as it would run on board."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, Self

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.io.plugins import failed
from modsim3d.runs.camera_sequences import CameraSequence
from modsim3d.runs.tracker_view import TrackerDetections
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame
from modsim3d.tracking.trackers.registry import NamedTracker
from modsim3d.tracks.tracks import FAR, Tracks, covariances, far_tracks

Named = Callable[[int, str], ModsimError]  # the error of a problem in a frame, by the frame's place in the sequence
_SYMMETRIC = 1e-6  # largest difference of the two covariances of x and y, as a share of the variances


class Answers:
    """The answers to some frames of a camera, as columns: k rows, in the order of the frames. `frame` is the place of
    the frame in the sequence, `track` the number that the tracker gave, `label` the index or −1 for none, and
    `confidence` NaN for none, shapes (k,); `boxes_px` x_min, y_min, x_max, y_max, shape (k, 4); `covariance_px2` NaN
    for none, shape (k, 2, 2)."""

    def __init__(self, answers: Sequence[TrackedFrame], facts: CameraFacts, problem: Named) -> None:
        """Join answers, one for each frame. Raises what `problem` makes if one cannot be an answer."""
        columns = [_columns(answer, partial(problem, at)) for at, answer in enumerate(answers)]
        counts = [len(each[0]) for each in columns]
        self.frame: Indices = np.repeat(np.arange(len(columns)), counts)
        empty = _columns(TrackedFrame.empty(), partial(problem, 0))
        self.track, self.boxes_px, self.label, self.confidence, self.covariance_px2 = (
            np.concatenate(parts) for parts in zip(empty, *columns, strict=True)
        )
        self._refuse(problem, len(facts.labels), np.array(facts.image_size_px))

    def _refuse(self, problem: Named, labels: int, image_px: Array) -> None:
        """Refuse values that cannot be."""
        x_min, y_min, x_max, y_max = self.boxes_px.T
        order = np.lexsort((self.track, self.frame))
        twice = np.zeros(len(order), dtype=bool)
        twice[order[1:]] = (np.diff(self.frame[order]) == 0) & (np.diff(self.track[order]) == 0)
        confidence = self.confidence
        upright = (x_max > x_min) & (y_max > y_min)
        possible = np.isnan(confidence) | ((confidence >= 0) & (confidence <= 1))
        box = "a box is x_min, y_min, x_max, y_max, with a positive width and height, not"
        index = f"a label is an index from 0 to {labels - 1}, or -1 for none, not"
        checks: tuple[tuple[Mask, str, Array | Indices], ...] = (
            (twice, "two boxes have the track", self.track),
            (~np.isfinite(self.boxes_px).all(axis=1), "a box must be finite, not", self.boxes_px),
            (~upright, box, self.boxes_px),
            ((self.label < -1) | (self.label >= labels), index, self.label),
            (~possible, "a confidence is from 0 to 1, not", confidence),
            (far_tracks(self.boxes_px, self.track, image_px), f"{FAR}:", self.boxes_px),
            (~_possible(self.covariance_px2), "this is no covariance of x and y:", self.covariance_px2),
        )
        for wrong, text, column in checks:
            if wrong.any():
                row = int(np.argmax(wrong))
                raise problem(int(self.frame[row]), f"track {self.track[row]}: {text} {_shown(column[row])}")

    def numbered(self) -> Self:
        """Number the tracks 1, 2, … in order of their first box, as nobody else's numbers start where they did."""
        _, first, inverse = np.unique(self.track, return_index=True, return_inverse=True)
        rank = np.empty(len(first), dtype=np.int64)
        rank[np.argsort(first)] = np.arange(1, len(first) + 1)
        self.track = rank[inverse.reshape(-1)]
        return self


def _columns(answer: TrackedFrame, refuse: Callable[[str], ModsimError]) -> tuple[Any, ...]:
    """Columns of an answer, of the right types and shapes."""
    if not isinstance(answer, TrackedFrame):
        raise refuse(f"the answer to a frame is a modsim3d.TrackedFrame, not {type(answer).__name__}")
    track = np.asarray(answer.track)
    if track.ndim != 1:
        raise refuse(f"TrackedFrame.track has one number for each track, shape (k,); got the shape {track.shape}")
    count = len(track)
    if count and not np.issubdtype(track.dtype, np.integer):
        raise refuse(f"TrackedFrame.track must be integers, not {track.dtype}")
    label = np.full(count, -1) if answer.label is None else np.asarray(answer.label)
    if count and not np.issubdtype(label.dtype, np.integer):
        raise refuse(f"TrackedFrame.label must be integers, not {label.dtype}")
    return (
        track.astype(np.int64),
        _floats(answer.boxes_px, "boxes_px", (count, 4), refuse),
        _shaped(label, "label", (count,), refuse).astype(np.int64),
        _floats(answer.confidence, "confidence", (count,), refuse),
        _floats(answer.covariance_px2, "covariance_px2", (count, 2, 2), refuse),
    )


def _floats(value: Any, name: str, shape: tuple[int, ...], refuse: Callable[[str], ModsimError]) -> Array:
    if value is None and name != "boxes_px":
        return np.full(shape, np.nan)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise refuse(f"TrackedFrame.{name} must be an array of numbers of the shape {shape}") from None
    shaped: Array = _shaped(array, name, shape, refuse)
    return shaped


def _shaped(array: Any, name: str, shape: tuple[int, ...], refuse: Callable[[str], ModsimError]) -> Any:
    if not array.size and not shape[0]:
        return np.empty(shape, dtype=array.dtype)  # an empty list has no second axis
    if array.shape != shape:
        raise refuse(f"TrackedFrame.{name} must have the shape {shape} with {shape[0]} tracks; got {array.shape}")
    return array


def _possible(covariance: Array) -> Mask:
    """Whether each matrix is a covariance, or NaN throughout, shape (k,)."""
    xx, xy, yx, yy = covariance.reshape(-1, 4).T
    alike = np.abs(xy - yx) <= _SYMMETRIC * (xx + yy)
    return (alike & covariances(xx, xy, yy)) | np.isnan(covariance).all(axis=(1, 2))


def _shown(value: Any) -> str:
    return ", ".join(f"{number:g}" for number in np.ravel(value).tolist())


Progress = Callable[[int], None]
_TOLD_FRAMES = 50  # frames between two calls of `progress`, since drawing a bar takes longer than a frame


def tracked(
    named: NamedTracker,
    sequences: Sequence[CameraSequence],
    cameras: Sequence[int],
    scene: Scene,
    progress: Progress = lambda frames: None,
) -> Tracks:
    """The tracks of a tracker in some cameras of a run; each camera is tracked by itself. Tracks are numbered 1, 2, …
    in order of their first box in each camera. `sequences` are the frames of the cameras, and `cameras` the indices of
    these in the scene; `progress` is called with the number of frames done since its last call. Raises ModsimError if
    the tracker fails, or answers otherwise than it should."""
    count, labels = len(scene.cameras), scene.detector.labels
    found = [Answers([], CameraFacts("", (1, 1), 0.0, ()), lambda at, text: ModsimError(text))]
    frames = [np.empty(0, dtype=np.int64)]
    for sequence, camera in zip(sequences, cameras, strict=True):
        facts = CameraFacts(sequence.camera.name, sequence.size_px, sequence.rate_hz, tuple(labels))
        answers = answered(named, facts, sequence.times_s, sequence.detections, progress)
        found.append(answers)
        frames.append(sequence.steps[answers.frame] * count + camera)
    columns = ("track", "boxes_px", "label", "confidence", "covariance_px2")
    return Tracks.of(
        count, np.concatenate(frames), *(np.concatenate([getattr(each, name) for each in found]) for name in columns)
    )


def answered(
    named: NamedTracker,
    facts: CameraFacts,
    times_s: Array,
    detections: TrackerDetections,
    progress: Progress = lambda frames: None,
) -> Answers:
    """The answers of a tracker to the frames of one camera, at these times, shape (F,); frames of the detections are
    places among them. Raises as `tracked` does."""
    feed = _CameraFeed(named, facts, times_s, detections)
    return Answers(list(feed.answers(progress)), facts, feed.problem).numbered()


class _CameraFeed:
    """A tracker and the frames of one camera, which it is given one by one."""

    def __init__(self, named: NamedTracker, facts: CameraFacts, times_s: Array, detections: TrackerDetections) -> None:
        self._named, self._facts, self._times_s, self._detections = named, facts, times_s, detections
        self._read = 0

    def problem(self, at: int, text: str) -> ModsimError:
        """The error of a problem in a frame, by its place in the sequence."""
        return ModsimError(f"{self._named}: camera '{self._facts.name}'{self._when(at)}: {text}")

    def _when(self, at: int) -> str:
        return f" at {self._times_s[at]:g} s" if at < len(self._times_s) else ""

    def answers(self, progress: Progress) -> Iterator[TrackedFrame]:
        """The tracker's answer to each frame. Raises ModsimError if it fails, reads a frame before it has answered the
        one before, or answers too often or seldom."""
        frames = len(self._times_s)
        answers = self._started()
        for at in range(frames):
            try:
                answer = self._next(answers, at)
            except StopIteration:
                raise self.problem(at, f"it ended after {at} of {frames} frames: it answers each frame once") from None
            if self._read > at + 1:
                problem = "it read the next frame before it answered this one: yield an answer for each frame"
                raise self.problem(at, problem)
            if self._read < at + 1:
                raise self.problem(at, "it answered before it read the frame: yield one answer for each frame")
            yield answer
            if (at + 1) % _TOLD_FRAMES == 0:
                progress(_TOLD_FRAMES)
        progress(frames % _TOLD_FRAMES)
        try:
            self._next(answers, frames)
        except StopIteration:
            return
        raise self.problem(frames, f"it gave more answers than the camera has frames ({frames})")

    def _started(self) -> Iterator[TrackedFrame]:
        try:
            answers = self._named.tracker.follow(self._frames(), self._facts)
        except (Exception, SystemExit) as error:
            raise self._failed(error, 0) from error
        if not hasattr(answers, "__iter__"):
            raise self.problem(0, f"follow must yield a modsim3d.TrackedFrame for each frame, not return {answers!r}")
        return iter(answers)

    def _next(self, answers: Iterator[TrackedFrame], at: int) -> TrackedFrame:
        try:
            return next(answers)
        except StopIteration:
            raise
        except (Exception, SystemExit) as error:
            raise self._failed(error, at) from error

    def _failed(self, error: Exception | SystemExit, at: int) -> BaseException:
        """The error of a plug-in with the camera and the time; that of a built-in tracker as it is."""
        if self._named.plugin is None:
            return error
        return ModsimError(f"{failed(self._named.plugin, error)}, camera '{self._facts.name}'{self._when(at)}")

    def _frames(self) -> Iterator[SensedFrame]:
        """The frames of the camera, with arrays of their own, which a tracker may write to."""
        sensed, times_s = self._detections, self._times_s
        edges = np.searchsorted(sensed.frame, np.arange(len(times_s) + 1)).tolist()
        for at, (start, stop) in enumerate(pairwise(edges)):
            self._read += 1
            yield SensedFrame(
                float(times_s[at]),
                sensed.boxes_px[start:stop].copy(),
                sensed.label[start:stop].copy(),
                sensed.confidence[start:stop].copy(),
            )
