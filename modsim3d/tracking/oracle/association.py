"""Tracks of detections that are associated by where they came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.boxes import at_least_a_pixel, clip, corner_form
from modsim3d.runs.files.columns import NOBODY, indices, numbers, positions
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.told import Told, told
from modsim3d.tracking.oracle.noise import SmootherNoise, smoother_noise
from modsim3d.tracking.oracle.smoothing import BoxSequences, smoothed_motion
from modsim3d.tracks.tracks import Tracks
from modsim3d.tracks.true_tracks import TrueTracks


@dataclass(frozen=True, eq=False)
class Provenance:
    """The detections of vessels, at most one of each identity in a frame: m rows in order of identity and frame.

    Attributes:
        identity: Of the vessel that each came from, as in `TrueTracks`, shape (m,).
        detections: What a tracker reads of them.
    """

    identity: Indices
    detections: Told

    @classmethod
    def of(cls, rows: RunRows, truth: TrueTracks) -> Provenance:
        """The detections of a run; false positives, and second boxes of a vessel, are left out."""
        identity_of = np.full(len(rows.truth_frame), NOBODY)
        identity_of[truth.row] = truth.identity
        count = len(rows.detection_frame)
        confidence = numbers(rows.detections, "confidence")
        # Rows in place of labels, to find them again: `told` sorts.
        every = told(rows.detection_frame, np.arange(count), rows.detection_boxes_px(), confidence)
        row, labels = every.label, indices(rows.detections, "label", rows.scene.detector.labels)
        detected = rows.detected_row[row]
        identity = np.where(detected == NOBODY, NOBODY, identity_of[detected])
        order = np.lexsort((every.frame, identity))
        order = order[identity[order] != NOBODY]
        found = Told(every.frame, labels[row], every.boxes_px, every.confidence).take(order)
        return cls(identity[order], found)


def oracle_tracks(rows: RunRows, truth: TrueTracks, *, smoothed: bool, noise: SmootherNoise | None = None) -> Tracks:
    """The oracle-association reference: what perfect association makes of the detections that a tracker gets.

    It is not a ceiling: a tracker that smooths better may exceed it. The number of a track is the identity that it
    follows.

    Args:
        rows: The run.
        truth: The vessels, with their identities.
        smoothed: False: the detected boxes. True: a box in each frame of the camera from the first detection of the
            identity to the last, smoothed with what comes before and after, with the covariance of its centre.
        noise: Of the smoother; None for that of the scene's name in `scenes/trackers/oracle.yaml`.
    """
    provenance = Provenance.of(rows, truth)
    found, cameras = provenance.detections, len(rows.scene.cameras)
    if not smoothed or not len(found):
        return Tracks.of(cameras, found.frame, provenance.identity, found.boxes_px, found.label, found.confidence)
    spans = Spans.of(rows, provenance)
    motion = smoothed_motion(spans.sequences, noise or smoother_noise(rows.scene.name))
    place, variance = (np.array([getattr(each, name) for each in motion]) for name in ("place", "place_variance"))
    row, column = np.nonzero(spans.frame != NOBODY)
    last = np.maximum.accumulate(spans.detection, axis=0)[row, column]  # a row's detection, or the last one before it
    seen, frame = spans.sequences.there[row, column], spans.frame[row, column]
    size_px = np.array([camera.intrinsics.image_size_px for camera in rows.scene.cameras])[frame % cameras]
    boxes_px = clip(corner_form(np.maximum(place[row, column], [-np.inf, -np.inf, 1, 1])), size_px)
    return Tracks.of(
        cameras,
        frame,
        spans.identity[column],
        at_least_a_pixel(boxes_px, size_px),
        found.label[last],
        np.where(seen, found.confidence[last], np.nan),
        variance[row, column, :2, None] * np.eye(2),
    )


@dataclass(frozen=True, eq=False)
class Spans:
    """The frames of I identities from the first detection of each to its last, in rows 0 to at most L − 1.

    Attributes:
        identity: Shape (I,).
        frame: Number of the frame; `NOBODY` after the last detection, shape (L, I).
        detection: Row of the detection in the frame; `NOBODY` where there is none, shape (L, I).
        sequences: The detected boxes.
    """

    identity: Indices
    frame: Indices
    detection: Indices
    sequences: BoxSequences

    @classmethod
    def of(cls, rows: RunRows, provenance: Provenance) -> Spans:
        """The spans of at least one detection."""
        cameras, detected = len(rows.scene.cameras), provenance.detections.frame
        by_camera = np.lexsort((rows.frames, rows.frames % cameras))
        taken = rows.frames[by_camera]  # those of each camera follow each other
        place = positions(taken, detected)
        identity, first, column, count = np.unique(
            provenance.identity, return_index=True, return_inverse=True, return_counts=True
        )
        start, end = place[first], place[first + count - 1]
        length = int((end - start).max()) + 1
        rows_of = start + np.arange(length)[:, None]
        frame = np.where(rows_of <= end, taken[np.minimum(rows_of, len(taken) - 1)], NOBODY)
        detection = np.full(frame.shape, NOBODY)
        detection[place - start[column], column] = np.arange(len(detected))
        times_s = rows.scene.times_s(0, rows.steps)[frame // cameras]
        time_s = np.ones(frame.shape)
        inside = frame[1:] != NOBODY
        time_s[1:][inside] = np.diff(times_s, axis=0)[inside]
        boxes_px = provenance.detections.boxes_px[detection]
        return cls(identity, frame, detection, BoxSequences(boxes_px, detection != NOBODY, time_s))
