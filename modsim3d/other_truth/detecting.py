"""The detector over the videos of a labelled set, some frames at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.chain import Detector, take_census
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import Clock
from modsim3d.detector.records import CameraFrames, Detections, Targets
from modsim3d.formats.horizon import EVERYWHERE
from modsim3d.other_truth.sought import Sought
from modsim3d.other_truth.videos import Video
from modsim3d.runs.counts import Counts, detection_counts

BLOCK_BOXES, BLOCK_FRAMES = 8000, 2000
"""About so many boxes, and at most so many frames, are worked on at once; no result depends on it."""


@dataclass(frozen=True, eq=False)
class Part:
    """Consecutive frames of a video, and what the detector was given and made of them.

    Attributes:
        steps: Place of each frame in the video, shape (S,).
        rows: Rows of the sought boxes in these frames, shape (n,).
        frame: Frame of each, counted from the first, shape (n,).
        target_rows: Which of these rows are visible, and were given to the detector, shape (k,).
    """

    video: Video
    steps: Indices
    rows: Indices
    frame: Indices
    target_rows: Indices
    detections: Detections

    @property
    def times_s(self) -> Array:
        """Times of the frames as the file has them, shape (S,)."""
        return self.video.times_s[self.steps]

    @property
    def origin(self) -> Indices:
        """Row of the sought boxes that each detection came from, −1 for none, shape (m,)."""
        target = self.detections.target
        if not len(self.target_rows):
            return np.full(len(target), -1)
        return np.where(target >= 0, self.rows[self.target_rows[target]], -1)

    @property
    def detected(self) -> Mask:
        """Which of the sought boxes were detected, shape (n,)."""
        found, detections = np.zeros(len(self.rows), dtype=bool), self.detections
        own, shared = detections.target[~detections.false()], detections.partner[detections.partner >= 0]
        found[self.target_rows[np.concatenate([own, shared])]] = True
        return found


@dataclass(frozen=True, eq=False)
class _Block:
    """What the detector is given at once."""

    video: Video
    rows: Indices
    frame: Indices
    target_rows: Indices
    frames: CameraFrames
    targets: Targets


def detected_parts(
    videos: Sequence[Video],
    sought: Sought,
    tracks: Sequence[int | str],
    model: DetectorModel,
    seed: int,
    horizon: Array | None,
) -> Iterator[Part]:
    """Run a detector over all videos, each of which is a camera of its own.

    Args:
        videos: The videos.
        sought: Their boxes.
        tracks: Names of the tracks.
        model: The detector.
        seed: Its seed.
        horizon: The half-plane of the sea, shape (3,); None if it is not known.
    """
    sea = EVERYWHERE if horizon is None else horizon
    start_s = min(float(video.times_s[0]) for video in videos)
    rows = _rows_of(videos, sought)
    blocks = [
        list(_blocks(video, *of_video, sought, tracks, start_s, sea))
        for video, of_video in zip(videos, rows, strict=True)
    ]
    census = take_census(model, ((block.frames, block.targets) for of_video in blocks for block in of_video))
    for video, of_video in zip(videos, blocks, strict=True):
        detector = Detector(model, seed, census, _clock(video.times_s - start_s))
        for block in of_video:
            detections = detector.detect(block.frames, block.targets)
            yield Part(video, block.frames.steps, block.rows, block.frame, block.target_rows, detections)


def _clock(times_s: Array) -> Clock:
    return lambda first, stop: times_s[first:stop]


def _rows_of(videos: Sequence[Video], sought: Sought) -> list[tuple[Indices, Indices]]:
    """For each video the rows of its boxes, and the frame of each, both of shape (n,) and in order of frame."""
    images = np.concatenate([video.images for video in videos])
    frame_of, place_of = np.empty(len(images), dtype=np.int64), np.empty(len(images), dtype=np.int64)
    lengths = [len(video.images) for video in videos]
    place_of[images] = np.arange(len(images))
    frame_of[images] = np.concatenate([np.arange(length) for length in lengths])
    rows = np.argsort(place_of[sought.image], kind="stable")
    edges = np.searchsorted(place_of[sought.image[rows]], np.cumsum(lengths)[:-1])
    return [(ours, frame_of[sought.image[ours]]) for ours in np.split(rows, edges)]


def _blocks(
    video: Video,
    rows: Indices,
    frame: Indices,
    sought: Sought,
    tracks: Sequence[int | str],
    start_s: float,
    sea: Array,
) -> Iterator[_Block]:
    used, vessel = np.unique(sought.track[rows], return_inverse=True)
    ids = tuple(str(tracks[track]) for track in used.tolist())
    for first, stop in _ranges(np.searchsorted(frame, np.arange(len(video.images) + 1))):
        ours = slice(*np.searchsorted(frame, (first, stop)))
        of_block, steps = rows[ours], np.arange(first, stop)
        visible = np.flatnonzero(sought.visible[of_block])
        targets = of_block[visible]
        frames = CameraFrames(
            camera=video.name,
            steps=steps,
            times_s=video.times_s[steps] - start_s,
            image_size_px=video.size_px,
            sea_half_planes=np.tile(sea, (len(steps), 1)),
            previous_s=float(video.times_s[first - 1]) - start_s if first else -math.inf,
        )
        seen = Targets(
            frame=frame[ours][visible] - first,
            vessel=vessel[ours][visible],
            label=sought.label[targets],
            boxes_px=sought.boxes_px[targets],
            visible_fraction=sought.visible_fraction[targets],
            depth_m=sought.depth_m[targets],
            vessel_ids=ids,
        )
        yield _Block(video, of_block, frame[ours] - first, visible, frames, seen)


def _ranges(starts: Indices) -> Iterator[tuple[int, int]]:
    """Runs of frames with about `BLOCK_BOXES` boxes each, given the row of each frame's first box, shape (S + 1,)."""
    first, count = 0, len(starts) - 1
    while first < count:
        stop = int(np.searchsorted(starts, starts[first] + BLOCK_BOXES, side="right")) - 1
        stop = min(max(stop, first + 1), first + BLOCK_FRAMES, count)
        yield first, stop
        first = stop


def count_part(part: Part, sought: Sought) -> Counts:
    """What happened in some frames; see `Counts`."""
    visible, origin = sought.visible_fraction[part.rows], part.origin[~part.detections.false()]
    return Counts(
        frames=len(part.steps),
        vessel_frames=len(part.rows),
        seen=int((visible > 0).sum()),
        partly_hidden=int(((visible > 0) & (visible < 1)).sum()),
        fully_hidden=int((visible == 0).sum()),
        annotated=len(part.target_rows),
        detected=(detected := int(part.detected.sum())),
        missed=len(part.target_rows) - detected,
        **detection_counts(part.detections, sought.boxes_px[origin], sought.label[origin]),
    )
