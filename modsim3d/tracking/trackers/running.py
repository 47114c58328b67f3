"""Runs a tracker over the frames of cameras, one after the other, as it would run on board."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from modsim3d.errors import ModsimError
from modsim3d.inputs.plugins import failed
from modsim3d.runs.camera_sequences import CameraSequence
from modsim3d.scene.scene import Scene
from modsim3d.tracking.trackers.answers import Answers
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame
from modsim3d.tracking.trackers.registry import NamedTracker
from modsim3d.tracks.tracks import Tracks

Progress = Callable[[int], None]
_TOLD_FRAMES = 50
"""Frames between two calls of `progress`, since drawing a bar takes longer than a frame."""


def tracked(
    named: NamedTracker,
    sequences: Sequence[CameraSequence],
    cameras: Sequence[int],
    scene: Scene,
    progress: Progress = lambda frames: None,
) -> Tracks:
    """The tracks of a tracker in some cameras of a run; each camera is tracked by itself.

    Tracks are numbered 1, 2, … in order of their first box in each camera.

    Args:
        named: The tracker.
        sequences: The frames of the cameras.
        cameras: Index of each of these cameras in the scene.
        scene: The scene of the run.
        progress: Called with the number of frames done since its last call.

    Raises:
        ModsimError: The tracker fails, or answers otherwise than it should.
    """
    count, labels = len(scene.cameras), scene.detector.labels
    found = [Answers([], CameraFacts("", (1, 1), 0.0, ()), lambda at, text: ModsimError(text))]
    frames = [np.empty(0, dtype=np.int64)]
    for sequence, camera in zip(sequences, cameras, strict=True):
        feed = _CameraFeed(named, sequence, tuple(labels))
        answers = Answers(list(feed.answers(progress)), feed.facts, feed.problem)
        found.append(answers.numbered())
        frames.append(sequence.steps[answers.frame] * count + camera)
    columns = ("track", "boxes_px", "label", "confidence", "covariance_px2")
    return Tracks.of(
        count, np.concatenate(frames), *(np.concatenate([getattr(each, name) for each in found]) for name in columns)
    )


class _CameraFeed:
    """A tracker and the frames of one camera, which it is given one by one."""

    def __init__(self, named: NamedTracker, sequence: CameraSequence, labels: tuple[str, ...]) -> None:
        self._named, self._sequence = named, sequence
        self.facts = CameraFacts(sequence.camera.name, sequence.size_px, sequence.rate_hz, labels)
        self._read = 0

    def problem(self, at: int, text: str) -> ModsimError:
        """The error of a problem in a frame, by its place in the sequence."""
        return ModsimError(f"{self._named}: camera '{self._sequence.camera.name}'{self._when(at)}: {text}")

    def _when(self, at: int) -> str:
        return f" at {self._sequence.times_s[at]:g} s" if at < len(self._sequence.times_s) else ""

    def answers(self, progress: Progress) -> Iterator[TrackedFrame]:
        """The tracker's answer to each frame.

        Raises:
            ModsimError: It fails, reads a frame before it has answered the one before, or answers too often or seldom.
        """
        frames = len(self._sequence.steps)
        answers = self._started()
        for at in range(frames):
            try:
                answer = self._next(answers, at)
            except StopIteration:
                raise self.problem(at, f"it ended after {at} of {frames} frames: it answers each frame once") from None
            if self._read > at + 1:
                raise self.problem(
                    at, "it read the next frame before it answered this one: yield an answer for each frame"
                )
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
            answers = self._named.tracker.follow(self._frames(), self.facts)
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
        return ModsimError(f"{failed(self._named.plugin, error)}, camera '{self.facts.name}'{self._when(at)}")

    def _frames(self) -> Iterator[SensedFrame]:
        """The frames of the camera, with arrays of their own, which a tracker may write to."""
        sensed, times_s = self._sequence.detections, self._sequence.times_s
        edges = np.searchsorted(sensed.frame, np.arange(len(times_s) + 1)).tolist()
        for at, (start, stop) in enumerate(pairwise(edges)):
            self._read += 1
            yield SensedFrame(
                float(times_s[at]),
                sensed.boxes_px[start:stop].copy(),
                sensed.label[start:stop].copy(),
                sensed.confidence[start:stop].copy(),
            )
