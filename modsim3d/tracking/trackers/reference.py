"""The reference tracker: a Kalman filter in the image and one best assignment a frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import centre_form, clip, corner_form, inside_image
from modsim3d.io.validation import NotNegative, Positive, Probability
from modsim3d.tracking.kalman import MotionEstimates
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame, Tracker

_SIZE_NOISE = 1.5  # noise of width and height over that of the centre: between 1.2 and 1.8 in the shipped detectors
_SIZE_WALK = 0.2  # share by which a box's size changes in a second
_FORBIDDEN = 1e6
_MIN_TRACKS = 3  # tracks with a detection from which the turn of the camera is taken
_TIME_S = 1e-6  # times are differences of rounded ones, maybe since 1970: one that is as long as allowed is not longer


@dataclass(frozen=True, eq=False)
class _LiveTracks:
    """The tracks that are alive: k rows; shapes (k,) unless given."""

    # Centre x, centre y, width and height, shape (k, 4). A size has no rate: it would shrink behind others.
    motion: MotionEstimates
    number: Indices  # of the track
    hits: Indices  # detections so far
    misses: Indices  # frames without detection before the track was confirmed
    seen_s: Array  # time of the last detection
    votes: Array  # confidence of its detections, summed by label, shape (k, labels)
    confidence: Array  # of the last detection

    def take(self, chosen: Mask) -> _LiveTracks:
        _, *columns = vars(self).values()
        return _LiveTracks(self.motion.take(chosen), *(column[chosen] for column in columns))

    def joined(self, more: _LiveTracks) -> _LiveTracks:
        _, *columns = zip(vars(self).values(), vars(more).values(), strict=True)
        return _LiveTracks(self.motion.joined(more.motion), *(np.concatenate(pair) for pair in columns))


class ReferenceTracker(Tracker):
    """A yardstick and an example, not a product: what a textbook's tracker reaches in a hundred lines. A Kalman filter
    with constant velocity follows the centre of each box, with the true times of the frames; width and height are
    random walks. Detections within the gate (Mahalanobis distance of the centres) are assigned to tracks so that most
    tracks get one, and then the likelihood is largest (global nearest neighbour; Blackman & Popoli (1999), section
    6.4). What the tracks of a frame are off by together is taken for a turn of the camera. Classes are not looked at: a
    track has the class with the most confidence behind it. The defaults suit a detector whose errors grow with the box;
    noise and motion in pixels should be those of the scene."""

    noise_share: NotNegative = 0.04  # standard deviation of a detected centre, as a share of the box's width and height
    noise_x_px: Positive = 4.0  # added to that across
    noise_y_px: Positive = 2.0  # added to it down the image
    velocity_change_px_s: Positive = 5.0  # standard deviation of the change of the velocity in one second, in px/s
    first_speed_px_s: Positive = 80.0  # standard deviation of the velocity of a new track, in each direction
    # Probability that a track's own detection lies in its gate.
    gate_probability: Annotated[float, Field(strict=True, gt=0, lt=1)] = 0.99
    start_confidence: Probability = 0.5  # least confidence of a detection that starts a track; others continue tracks
    # Detections until a track is reported, in at most one frame more than that.
    confirm_hits: Annotated[int, Field(strict=True, ge=1, le=100)] = 3
    lost_s: NotNegative = 8.0  # a track without detection for longer than this ends
    coast_s: NotNegative = 2.0  # a track without detection is reported at its predicted place for at most this time

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        """Track the detections of one camera; see `Tracker`."""
        tracks, begun, before_s = None, 0, 0.0
        for frame in frames:
            free = np.ones(len(frame.boxes_px), dtype=bool)
            if tracks is not None:
                tracks = self._alive(tracks, frame.time_s)
                motion = self._predicted(tracks.motion, frame.time_s - before_s)
                steadied = self._steadied(motion, frame)
                track, detection = self._assigned(steadied, frame)
                tracks = replace(tracks, motion=steadied.with_rows(track, motion.take(track)))
                tracks = self._corrected(tracks, frame, track, detection)
                free[detection] = False
            fresh = np.flatnonzero(free & (frame.confidence >= self.start_confidence))
            new = self._new(frame, fresh, begun, len(camera.labels))
            tracks = new if tracks is None else tracks.joined(new) if len(fresh) else tracks
            begun, before_s = begun + len(fresh), frame.time_s
            yield self._reported(tracks, frame.time_s, camera)

    def _new(self, frame: SensedFrame, rows: Indices, begun: int, labels: int) -> _LiveTracks:
        """Tracks of some of a frame's detections, numbered from `begun` on."""
        boxes, votes = centre_form(frame.boxes_px[rows]), np.zeros((len(rows), labels))
        votes[np.arange(len(rows)), frame.label[rows]] = frame.confidence[rows]
        motion = MotionEstimates.at(boxes, self._noise_px2(boxes), np.repeat([self.first_speed_px_s**2, 0.0], 2))
        number = np.arange(begun, begun + len(rows))
        ones, seen_s = np.ones_like(number), np.full(len(rows), frame.time_s)
        return _LiveTracks(motion, number, ones, ones - 1, seen_s, votes, frame.confidence[rows])

    def _noise_px2(self, boxes: Array) -> Array:
        """Variance of detected centres, widths and heights, for boxes of about these sizes, shape (k, 4)."""
        noise_px = self.noise_share * np.maximum(boxes[:, 2:], 1) + np.array([self.noise_x_px, self.noise_y_px])
        return np.concatenate([noise_px, _SIZE_NOISE * noise_px], axis=1) ** 2

    def _predicted(self, motion: MotionEstimates, time_s: float) -> MotionEstimates:
        walk = _SIZE_WALK * np.maximum(motion.place, 1) * [0, 0, 1, 1]
        return motion.predicted(time_s, np.repeat([self.velocity_change_px_s, 0.0], 2), walk)

    def _steadied(self, motion: MotionEstimates, frame: SensedFrame) -> MotionEstimates:
        """Moved by what all tracks are off by: the camera has turned."""
        track, detection = self._assigned(motion, frame)
        if len(track) < _MIN_TRACKS:
            return motion
        off = np.median(centre_form(frame.boxes_px)[detection, :2] - motion.place[track, :2], axis=0)
        return replace(motion, place=motion.place + np.append(off, [0, 0]))

    def _assigned(self, motion: MotionEstimates, frame: SensedFrame) -> tuple[Indices, Indices]:
        """Rows of the tracks that have a detection, and of their detections."""
        variance = (motion.place_variance + self._noise_px2(motion.place))[:, None]
        squared = (centre_form(frame.boxes_px) - motion.place[:, None]) ** 2 / variance
        near = squared[..., :2].sum(axis=-1) <= -2 * np.log1p(-self.gate_probability)  # chi-square with two degrees
        distance = squared.sum(axis=-1)
        track, detection = linear_sum_assignment(np.where(near, distance + np.log(variance).sum(axis=-1), _FORBIDDEN))
        good = near[track, detection]
        return track[good], detection[good]

    def _corrected(self, tracks: _LiveTracks, frame: SensedFrame, track: Indices, detection: Indices) -> _LiveTracks:
        motion = tracks.motion.take(track)
        better = motion.corrected(centre_form(frame.boxes_px[detection]), self._noise_px2(motion.place))
        motion = tracks.motion.with_rows(track, better)
        hits, seen_s, confidence = tracks.hits.copy(), tracks.seen_s.copy(), tracks.confidence.copy()
        votes, missed = tracks.votes.copy(), np.ones(len(hits), dtype=bool)
        missed[track] = False
        misses = tracks.misses + (missed & (hits < self.confirm_hits))
        hits[track] += 1
        seen_s[track], confidence[track] = frame.time_s, frame.confidence[detection]
        votes[track, frame.label[detection]] += frame.confidence[detection]
        return _LiveTracks(motion, tracks.number, hits, misses, seen_s, votes, confidence)

    def _alive(self, tracks: _LiveTracks, time_s: float) -> _LiveTracks:
        unconfirmed = (tracks.hits < self.confirm_hits) & (tracks.misses > 1)
        alive = (time_s - tracks.seen_s <= self.lost_s + _TIME_S) & ~unconfirmed
        return tracks if alive.all() else tracks.take(alive)

    def _reported(self, tracks: _LiveTracks, time_s: float, camera: CameraFacts) -> TrackedFrame:
        motion = tracks.motion
        boxes = corner_form(np.concatenate([motion.place[:, :2], np.maximum(motion.place[:, 2:], 1)], axis=1))
        shown = (tracks.hits >= self.confirm_hits) & (time_s - tracks.seen_s <= self.coast_s + _TIME_S)
        shown &= inside_image(boxes, camera.image_size_px)
        covariance = motion.place_variance[shown, :2, None] * np.eye(2)
        label = tracks.votes[shown].argmax(axis=1) if tracks.votes.shape[1] else None
        boxes = clip(boxes[shown], camera.image_size_px)
        return TrackedFrame(tracks.number[shown], boxes, label, tracks.confidence[shown], covariance)
