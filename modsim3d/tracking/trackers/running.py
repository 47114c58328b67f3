"""Runs a tracker over frames of cameras, or steps in the world, one after the other, as it would run on board."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, Self

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.io.coprocess import Coprocess, CoprocessError
from modsim3d.io.plugins import failed
from modsim3d.runs.camera_sequences import CameraSequence, sequences_of
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.tracker_view import TrackerDetections
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.command import CommandTracker, Exchange
from modsim3d.tracking.trackers.interface import CameraFacts, TrackedFrame, Tracker
from modsim3d.tracking.trackers.registry import NamedTracker
from modsim3d.tracking.trackers.world_input import facts_of, sensed_frames, world_steps
from modsim3d.tracking.trackers.world_interface import WorldTrackedStep, WorldTracker
from modsim3d.tracks.tracks import FAR, Tracks, WorldTracks, covariances, far_tracks

Refuse = Callable[[str], ModsimError]  # the error of a problem in one answer
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
        counts = [len(arrays[0]) for arrays in columns]
        self.frame: Indices = np.repeat(np.arange(len(columns)), counts)
        empty = _columns(TrackedFrame.empty(), partial(problem, 0))
        self.track, self.boxes_px, self.label, self.confidence, self.covariance_px2 = (
            np.concatenate(parts) for parts in zip(empty, *columns, strict=True)
        )
        self._refuse(problem, len(facts.labels), np.array(facts.image_size_px))

    def _refuse(self, problem: Named, labels: int, image_px: Array) -> None:
        x_min, y_min, x_max, y_max = self.boxes_px.T
        confidence = self.confidence
        upright = (x_max > x_min) & (y_max > y_min)
        possible = np.isnan(confidence) | ((confidence >= 0) & (confidence <= 1))
        box = "a box is x_min, y_min, x_max, y_max, with a positive width and height, not"
        index = f"a label is an index from 0 to {labels - 1}, or -1 for none, not"
        checks: tuple[tuple[Mask, str, Array | Indices], ...] = (
            (_repeats(self.frame, self.track), "two boxes have the track", self.track),
            (~np.isfinite(self.boxes_px).all(axis=1), "a box must be finite, not", self.boxes_px),
            (~upright, box, self.boxes_px),
            ((self.label < -1) | (self.label >= labels), index, self.label),
            (~possible, "a confidence is from 0 to 1, not", confidence),
            (far_tracks(self.boxes_px, self.track, image_px), f"{FAR}:", self.boxes_px),
            (~_possible(self.covariance_px2), "this is no covariance of x and y:", self.covariance_px2),
        )
        _refuse_first(checks, self.frame, self.track, problem)

    def numbered(self) -> Self:
        """Number the tracks 1, 2, … in order of their first box, as nobody else's numbers start where they did."""
        self.track = _in_order(self.track)
        return self


def _in_order(track: Indices) -> Indices:
    """Numbers 1, 2, … in order of the first row of each track, shape (k,)."""
    _, first, inverse = np.unique(track, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(1, len(first) + 1)
    numbers: Indices = rank[inverse.reshape(-1)]
    return numbers


def world_tracks_of(name: str, answers: Sequence[WorldTrackedStep], times_s: Array, problem: Named) -> WorldTracks:
    """The answers to steps at these times, shape (S,), as tracks that are numbered 1, 2, … in order of their first
    estimate. Raises what `problem` makes if one cannot be an answer."""
    parts = [_world_columns(answer, partial(problem, at)) for at, answer in enumerate(answers)]
    none = _world_columns(WorldTrackedStep.empty(), partial(problem, 0))
    step = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    track, position, velocity, covariance = (np.concatenate(column) for column in zip(none, *parts, strict=True))
    checks: tuple[tuple[Mask, str, Array | Indices], ...] = (
        (_repeats(step, track), "two estimates have the track", track),
        (~np.isfinite(position).all(axis=1), "a position must be finite, not", position),
        (np.isinf(velocity).any(axis=1), "a velocity must be finite, or NaN where unknown, not", velocity),
        (~_definite(covariance), "this is no covariance of position and velocity:", covariance),
    )
    _refuse_first(checks, step, track, problem)
    number = _in_order(track)
    count = int(number.max(initial=0))
    names = tuple(f"{index:0{len(str(count))}}" for index in range(1, count + 1))  # in this order as text too
    return WorldTracks.of(name, number - 1, names, times_s[step], position, velocity, covariance)


def _world_columns(answer: WorldTrackedStep, refuse: Refuse) -> tuple[Any, ...]:
    if not isinstance(answer, WorldTrackedStep):
        raise refuse(f"the answer to a step is a modsim3d.plugins.WorldTrackedStep, not {type(answer).__name__}")
    track = _track_numbers(answer, refuse)
    count = len(track)
    whole = np.full((count, 4, 4), np.nan)
    side = 2 if np.shape(np.array([]) if answer.covariance is None else answer.covariance)[1:] == (2, 2) else 4
    whole[:, :side, :side] = _floats(answer, "covariance", (count, side, side), refuse)
    position, velocity = (_floats(answer, name, (count, 2), refuse) for name in ("position_m", "velocity_m_s"))
    return track.astype(np.int64), position, velocity, whole


def _repeats(at: Indices, track: Indices) -> Mask:
    """Whether a track was there before at the same place of the sequence, shape (k,)."""
    order = np.lexsort((track, at))
    twice = np.zeros(len(order), dtype=bool)
    twice[order[1:]] = (np.diff(at[order]) == 0) & (np.diff(track[order]) == 0)
    return twice


def _refuse_first(
    checks: Sequence[tuple[Mask, str, Array | Indices]], at: Indices, track: Indices, problem: Named
) -> None:
    """Raise for the first row that a check is wrong in."""
    for wrong, text, column in checks:
        if wrong.any():
            row = int(np.argmax(wrong))
            raise problem(int(at[row]), f"track {track[row]}: {text} {_numbers_text(column[row])}")


def _columns(answer: TrackedFrame, refuse: Refuse) -> tuple[Any, ...]:
    if not isinstance(answer, TrackedFrame):
        raise refuse(f"the answer to a frame is a modsim3d.TrackedFrame, not {type(answer).__name__}")
    track = _track_numbers(answer, refuse)
    count = len(track)
    label = np.full(count, -1) if answer.label is None else np.asarray(answer.label)
    if count and not np.issubdtype(label.dtype, np.integer):
        raise refuse(f"TrackedFrame.label must be integers, not {label.dtype}")
    return (
        track.astype(np.int64),
        _floats(answer, "boxes_px", (count, 4), refuse),
        _shaped(label, "TrackedFrame.label", (count,), refuse).astype(np.int64),
        _floats(answer, "confidence", (count,), refuse),
        _floats(answer, "covariance_px2", (count, 2, 2), refuse),
    )


def _track_numbers(answer: TrackedFrame | WorldTrackedStep, refuse: Refuse) -> Any:
    """Numbers of the tracks of an answer, shape (k,)."""
    track, called = np.asarray(answer.track), f"{type(answer).__name__}.track"
    if track.ndim != 1:
        raise refuse(f"{called} has one number for each track, shape (k,); got the shape {track.shape}")
    if len(track) and not np.issubdtype(track.dtype, np.integer):
        raise refuse(f"{called} must be integers, not {track.dtype}")
    return track


def _floats(answer: TrackedFrame | WorldTrackedStep, name: str, shape: tuple[int, ...], refuse: Refuse) -> Array:
    """An array of numbers of an answer; NaN where the answer has none and need not."""
    value, called = getattr(answer, name), f"{type(answer).__name__}.{name}"
    if value is None and name not in ("boxes_px", "position_m"):
        return np.full(shape, np.nan)
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise refuse(f"{called} must be an array of numbers of the shape {shape}") from None
    shaped: Array = _shaped(array, called, shape, refuse)
    return shaped


def _shaped(array: Any, called: str, shape: tuple[int, ...], refuse: Refuse) -> Any:
    if not array.size and not shape[0]:
        return np.empty(shape, dtype=array.dtype)  # an empty list has no second axis
    if array.shape != shape:
        raise refuse(f"{called} must have the shape {shape} with {shape[0]} tracks; got {array.shape}")
    return array


def _possible(covariance: Array) -> Mask:
    """Whether each matrix is a covariance, or NaN throughout, shape (k,)."""
    xx, xy, yx, yy = covariance.reshape(-1, 4).T
    alike = np.abs(xy - yx) <= _SYMMETRIC * (xx + yy)
    return (alike & covariances(xx, xy, yy)) | np.isnan(covariance).all(axis=(1, 2))


def _definite(covariance: Array) -> Mask:
    """Whether each matrix (k, 4, 4) is the covariance of position and velocity, of the position alone, or NaN
    throughout, shape (k,)."""
    at = covariance[:, :2, :2]
    possible = _possible(at)
    whole = np.isfinite(covariance).all(axis=(1, 2))
    apart = np.abs(covariance - np.swapaxes(covariance, 1, 2)).max(axis=(1, 2), initial=0)
    symmetric = apart <= _SYMMETRIC * np.trace(covariance, axis1=1, axis2=2)
    possible[whole] &= symmetric[whole] & (np.linalg.eigvalsh(covariance[whole])[:, 0] > 0)
    nothing_more = np.isnan(covariance[:, 2:]).all(axis=(1, 2)) & np.isnan(covariance[:, :2, 2:]).all(axis=(1, 2))
    return possible & (whole | nothing_more)


def _numbers_text(value: Any) -> str:
    return ", ".join(f"{number:g}" for number in np.ravel(value).tolist())


Progress = Callable[[int], None]
_TOLD_FRAMES = 50  # frames between two calls of `progress`, since drawing a bar takes longer than a frame


@dataclass(frozen=True, eq=False)
class TrackerRun:
    """Tracks of a tracker in the images or in the world, and what it took."""

    tracks: Tracks | WorldTracks
    seconds: Array  # working time for each frame, or step, in the order in which they were given: (n,)
    peak_memory_mb: float | None = None  # of a program

    @property
    def frame_ms(self) -> dict[str, float]:
        """Median, 99th percentile and greatest of the working times in ms; empty without frames."""
        if not len(self.seconds):
            return {}
        median, p99, greatest = np.quantile(1000 * self.seconds, (0.5, 0.99, 1), method="inverted_cdf").tolist()
        return {"median": median, "p99": p99, "max": greatest}


def run_tracker(named: NamedTracker, rows: RunRows, progress: Progress = lambda frames: None) -> TrackerRun:
    """Run a tracker over all cameras of a run. `progress` is called with the number of frames, or steps, done since its
    last call. Raises ModsimError if the tracker fails, answers otherwise than it should, or works in the world and the
    run has no places."""
    if isinstance(named.tracker, WorldTracker):
        feed = world_feed(named, rows)
        tracks = world_tracks_of(named.name, list(feed.answers(progress)), feed.times_s, feed.problem)
        return TrackerRun(tracks, np.array(feed.seconds))
    if isinstance(named.tracker, CommandTracker):
        return _by_command(named, named.tracker, rows, progress)
    cameras = tuple(range(len(rows.scene.cameras)))
    return _in_images(named, sequences_of(rows, cameras), cameras, rows.scene, progress)


def _by_command(named: NamedTracker, tracker: CommandTracker, rows: RunRows, progress: Progress) -> TrackerRun:
    scene, cameras = rows.scene, tuple(range(len(rows.scene.cameras)))
    with Coprocess(tracker.program, tracker.command, tracker.folder, tracker.timeout_s) as program:
        exchange = Exchange(program, rows)
        try:
            output = exchange.tracks(tracker.settings, progress)
        except ModsimError as error:
            failure = error if isinstance(error, CoprocessError) else program.error(str(error))
            raise CoprocessError(f"{named}: {exchange.at}: {failure.problem}", failure.stderr) from error
    took = np.array(exchange.seconds), program.peak_memory_mb
    if isinstance(output, list):
        times_s = scene.times_s(0, rows.steps)
        return TrackerRun(world_tracks_of(named.name, output, times_s, Feed(named, "", "step", times_s).problem), *took)
    sequences, answers = sequences_of(rows, cameras), []
    for sequence in sequences:
        feed = Feed(named, f"camera '{sequence.camera.name}'", "frame", sequence.times_s)
        answers.append(Answers(output[sequence.camera.name], camera_facts(sequence, scene), feed.problem).numbered())
    return TrackerRun(joined(answers, sequences, cameras, len(cameras)), *took)


def tracked(
    named: NamedTracker,
    sequences: Sequence[CameraSequence],
    cameras: Sequence[int],
    scene: Scene,
    progress: Progress = lambda frames: None,
) -> Tracks:
    """The tracks of a tracker of images in some cameras of a run; each camera is tracked by itself. Tracks are numbered
    1, 2, … in order of their first box in each camera. `sequences` are the frames of the cameras, and `cameras` the
    indices of these in the scene. Raises as `run_tracker` does."""
    tracks = _in_images(named, sequences, cameras, scene, progress).tracks
    assert isinstance(tracks, Tracks)
    return tracks


def _in_images(
    named: NamedTracker, sequences: Sequence[CameraSequence], cameras: Sequence[int], scene: Scene, progress: Progress
) -> TrackerRun:
    answers, seconds = [], list[float]()
    for sequence in sequences:
        facts = camera_facts(sequence, scene)
        feed = camera_feed(named, facts, sequence.times_s, sequence.detections)
        answers.append(Answers(list(feed.answers(progress)), facts, feed.problem).numbered())
        seconds += feed.seconds
    return TrackerRun(joined(answers, sequences, cameras, len(scene.cameras)), np.array(seconds))


def camera_facts(sequence: CameraSequence, scene: Scene) -> CameraFacts:
    """Facts on a camera that a tracker knows."""
    return CameraFacts(sequence.camera.name, sequence.size_px, sequence.rate_hz, tuple(scene.detector.labels))


def joined(parts: Sequence[Answers], sequences: Sequence[CameraSequence], cameras: Sequence[int], count: int) -> Tracks:
    """The tracks of some cameras, by their indices among the `count` of the scene."""
    none = Answers([], CameraFacts("", (1, 1), 0.0, ()), lambda at, text: ModsimError(text))
    frames = [
        sequence.steps[answer.frame] * count + camera
        for answer, sequence, camera in zip(parts, sequences, cameras, strict=True)
    ]
    columns = ("track", "boxes_px", "label", "confidence", "covariance_px2")
    return Tracks.of(
        count,
        np.concatenate([np.empty(0, dtype=np.int64), *frames]),
        *(np.concatenate([getattr(answer, name) for answer in (none, *parts)]) for name in columns),
    )


def answered(named: NamedTracker, facts: CameraFacts, times_s: Array, detections: TrackerDetections) -> Answers:
    """The answers of a tracker to the frames of one camera, at these times, shape (F,); frames of the detections are
    places among them. Raises as `tracked` does."""
    feed = camera_feed(named, facts, times_s, detections)
    return Answers(list(feed.answers(lambda frames: None)), facts, feed.problem).numbered()


def camera_feed(named: NamedTracker, facts: CameraFacts, times_s: Array, detections: TrackerDetections) -> Feed:
    """A tracker of images and the frames of one camera, for arguments see `answered`."""
    assert isinstance(named.tracker, Tracker)
    frames, follow = sensed_frames(times_s, detections), named.tracker.follow
    return Feed(named, f"camera '{facts.name}'", "frame", times_s, frames, lambda given: follow(given, facts))


def world_feed(named: NamedTracker, rows: RunRows) -> Feed:
    """A tracker in the world and the steps of a run."""
    assert isinstance(named.tracker, WorldTracker)
    facts, follow = facts_of(rows.scene), named.tracker.follow_world
    times_s = rows.scene.times_s(0, rows.steps)
    return Feed(named, "", "step", times_s, world_steps(rows), lambda given: follow(given, facts))


class Feed:
    """A tracker and what it is given one by one, frames or steps. `seconds` has the time that it took for each so
    far, without the time in which what it is given was made."""

    def __init__(
        self,
        named: NamedTracker,
        where: str,
        word: str,
        times_s: Array,
        given: Iterable[Any] = (),
        start: Callable[[Iterator[Any]], Any] = iter,
    ) -> None:
        """Take what is given, a thing at each of some times; errors call it `word`, and say `where` it is."""
        self._named, self._where, self._word, self.times_s = named, where, word, times_s
        self._given, self._start = given, start
        self._read, self._making_s = 0, 0.0
        self.seconds: list[float] = []

    def problem(self, at: int, text: str) -> ModsimError:
        """The error of a problem in a frame or step, by its place in the sequence."""
        return ModsimError(": ".join(filter(None, (str(self._named), self._at(at), text))))

    def _at(self, at: int) -> str:
        when = f"at {self.times_s[at]:g} s" if at < len(self.times_s) else ""
        return " ".join(filter(None, (self._where, when)))

    def answers(self, progress: Progress) -> Iterator[Any]:
        """The tracker's answer to each frame or step. Raises ModsimError if it fails, reads one before it has answered
        the one before, or answers too often or seldom."""
        count, word = len(self.times_s), self._word
        answers = self._started()
        for at in range(count):
            self._making_s, began = 0.0, perf_counter()
            try:
                answer = self._next(answers, at)
            except StopIteration:
                raise self.problem(at, f"it ended after {at} of {count} {word}s: it answers each {word} once") from None
            self.seconds.append(perf_counter() - began - self._making_s)
            if self._read > at + 1:
                problem = f"it read the next {word} before it answered this one: yield an answer for each {word}"
                raise self.problem(at, problem)
            if self._read < at + 1:
                raise self.problem(at, f"it answered before it read the {word}: yield one answer for each {word}")
            yield answer
            if (at + 1) % _TOLD_FRAMES == 0:
                progress(_TOLD_FRAMES)
        progress(count % _TOLD_FRAMES)
        try:
            self._next(answers, count)
        except StopIteration:
            return
        whose = "the camera" if self._where else "the run"
        raise self.problem(count, f"it gave more answers than {whose} has {word}s ({count})")

    def _started(self) -> Iterator[Any]:
        try:
            answers = self._start(self._one_by_one())
        except (Exception, SystemExit) as error:
            raise self._failed(error, 0) from error
        if not hasattr(answers, "__iter__"):
            in_world = "follow_world must yield a modsim3d.plugins.WorldTrackedStep for each step"
            wanted = in_world if self._word == "step" else "follow must yield a modsim3d.TrackedFrame for each frame"
            raise self.problem(0, f"{wanted}, not return {answers!r}")
        return iter(answers)

    def _next(self, answers: Iterator[Any], at: int) -> Any:
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
        return ModsimError(", ".join(filter(None, (str(failed(self._named.plugin, error)), self._at(at)))))

    def _one_by_one(self) -> Iterator[Any]:
        given, none = iter(self._given), object()
        while True:
            began = perf_counter()
            entry = next(given, none)
            self._making_s += perf_counter() - began
            if entry is none:
                return
            self._read += 1
            yield entry
