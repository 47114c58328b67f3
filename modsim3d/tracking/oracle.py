"""Tracks of detections that are associated by where they came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask, positions
from modsim3d.core.boxes import at_least_a_pixel, centre_form, clip, corner_form
from modsim3d.core.errors import InputError
from modsim3d.io.input_files import data_folder
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import NotNegative, Positive, Strict, describe
from modsim3d.runs.files.tables import indices, number_column
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.tracker_view import TrackerDetections, anonymised
from modsim3d.tracking.kalman import MotionEstimates
from modsim3d.tracking.scores.scored_run import Rules
from modsim3d.tracks.tracks import Tracks
from modsim3d.tracks.true_tracks import TrueTracks


class SmootherNoise(Strict):
    """Noise of detected boxes, and how the boxes of vessels move."""

    noise_share: NotNegative = 0.02  # standard deviation of a detected centre, as a share of the box's width and height
    noise_x_px: NotNegative = 5.0  # added to that across
    noise_y_px: NotNegative = 3.0  # added to it down the image
    size_noise: NotNegative = 1.5  # standard deviation of width and height, over that of the centre
    velocity_change_px_s: Positive = 5.0  # standard deviation of the change of the centre's velocity in one second
    growth_change_px_s: Positive = 2.0  # that of the rate at which a box grows

    def variance_px2(self, size_px: Array) -> Array:
        """Variance of centre x, centre y, width and height of detections of some size (..., 2), shape (..., 4)."""
        centre_px = self.noise_share * np.maximum(size_px, 1) + np.array([self.noise_x_px, self.noise_y_px])
        return np.concatenate([centre_px, self.size_noise * centre_px], axis=-1) ** 2

    @property
    def rate_walk_px_s(self) -> Array:
        """Change in one second of the rates of centre x, centre y, width and height, shape (4,)."""
        return np.repeat([self.velocity_change_px_s, self.growth_change_px_s], 2)


class _NoiseFile(Strict):
    """The content of the file: the noise of scenes by their names, and of all others."""

    default: SmootherNoise
    scenes: dict[str, SmootherNoise]


def smoother_noise(scene_name: str) -> SmootherNoise:
    """The noise for a scene, from the file that comes with the package. Raises InputError if that is damaged."""
    path = data_folder("scenes") / "trackers" / "oracle.yaml"
    content = load_yaml(path, "smoother noise")
    try:
        noise = _NoiseFile.model_validate(content)
    except ValidationError as error:
        raise InputError(f"smoother noise {path}", describe(error, _NoiseFile)) from None
    return noise.scenes.get(scene_name, noise.default)


_FIRST_RATE_PX_S = 1000.0  # standard deviation of a rate before anything is known of it: beyond any vessel's


@dataclass(frozen=True, eq=False)
class BoxSequences:
    """I sequences of boxes, each in rows 0 to at most L − 1 from its first detection on."""

    boxes_px: Array  # x_min, y_min, x_max, y_max; anything where there is no detection, shape (L, I, 4)
    present: Mask  # where there is a detection; everywhere in row 0, shape (L, I)
    time_s: Array  # since the row before, above 0, shape (L, I)


class FilteredRow(NamedTuple):
    """After a row: with its detections, and as predicted from the rows before; log-likelihood of its detections."""

    corrected: MotionEstimates
    predicted: MotionEstimates
    log_likelihood: float


def smoothed_motion(sequences: BoxSequences, noise: SmootherNoise) -> list[MotionEstimates]:
    """Centre x, centre y, width and height given all detections: for each row a motion of shape (I, 4). Forward a
    Kalman filter with constant velocity, back the recursion of Rauch, Tung & Striebel (1965), "Maximum likelihood
    estimates of linear dynamic systems", AIAA Journal 3(8). The noise of a detection goes by the size that the filter
    predicts, since the detected one has noise itself."""
    forward = filtered(sequences, noise)
    later = forward[-1].corrected
    motions = [later]
    for row in range(len(forward) - 2, -1, -1):
        time_s = sequences.time_s[row + 1, :, None]
        later = forward[row].corrected.smoothed(forward[row + 1].predicted, later, time_s)
        motions.append(later)
    return motions[::-1]


def filtered(sequences: BoxSequences, noise: SmootherNoise) -> list[FilteredRow]:
    """The filter's estimates of each row, from the first on."""
    boxes = centre_form(sequences.boxes_px)
    motion = MotionEstimates.at(boxes[0], noise.variance_px2(boxes[0, :, 2:]), _FIRST_RATE_PX_S**2)
    rows = [FilteredRow(motion, motion, 0.0)]
    for row in range(1, len(boxes)):
        present = sequences.present[row]
        predicted = motion.predicted(sequences.time_s[row, :, None], noise.rate_walk_px_s)
        seen, measured = predicted.take(present), boxes[row, present]
        variance = noise.variance_px2(seen.place[:, 2:])
        total = seen.place_variance + variance
        chance = -0.5 * float(np.sum((measured - seen.place) ** 2 / total + np.log(2 * np.pi * total)))
        motion = predicted.with_rows(present, seen.corrected(measured, variance))
        rows.append(FilteredRow(motion, predicted, chance))
    return rows


@dataclass(frozen=True, eq=False)
class DetectionSources:
    """The detections of vessels, at most one of each identity in a frame: m rows in order of identity and frame."""

    identity: Indices  # of the vessel that each came from, as in `TrueTracks`, shape (m,)
    detections: TrackerDetections  # what a tracker reads of them

    @classmethod
    def of(cls, rows: RunRows, truth: TrueTracks) -> DetectionSources:
        """The detections of a run; false positives, and second boxes of a vessel, are left out."""
        identity_of = np.full(len(rows.truth_frame), NOBODY)
        identity_of[truth.row] = truth.identity
        count = len(rows.detection_frame)
        confidence = number_column(rows.detections, "confidence")
        # Rows in place of labels, to find them again: `anonymised` sorts.
        every = anonymised(rows.detection_frame, np.arange(count), rows.detection_boxes_px(), confidence)
        row, labels = every.label, indices(rows.detections, "label", rows.scene.detector.labels)
        detected = rows.detected_row[row]
        identity = np.where(detected == NOBODY, NOBODY, identity_of[detected])
        order = np.lexsort((every.frame, identity))
        order = order[identity[order] != NOBODY]
        hits = TrackerDetections(every.frame, labels[row], every.boxes_px, every.confidence).take(order)
        return cls(identity[order], hits)


def oracle_tracks(rows: RunRows, truth: TrueTracks, *, smoothed: bool, noise: SmootherNoise | None = None) -> Tracks:
    """The oracle-association reference: what perfect association makes of the detections that a tracker gets. It is not
    a ceiling: a tracker that smooths better may exceed it. The number of a track is the identity that it follows. Boxes
    are the detected ones; or, if `smoothed`, one in each frame of the camera from the first detection of the identity
    to the last, smoothed with what comes before and after, with the covariance of its centre. The noise of the smoother
    is that of the scene's name in `scenes/trackers/oracle.yaml` if None."""
    provenance = DetectionSources.of(rows, truth)
    hits, cameras = provenance.detections, len(rows.scene.cameras)
    if not smoothed or not len(hits):
        return Tracks.of(cameras, hits.frame, provenance.identity, hits.boxes_px, hits.label, hits.confidence)
    spans = IdentitySpans.of(rows, provenance)
    motion = smoothed_motion(spans.sequences, noise or smoother_noise(rows.scene.name))
    place, variance = (np.array([getattr(state, name) for state in motion]) for name in ("place", "place_variance"))
    row, column = np.nonzero(spans.frame != NOBODY)
    last = np.maximum.accumulate(spans.detection, axis=0)[row, column]  # a row's detection, or the last one before it
    seen, frame = spans.sequences.present[row, column], spans.frame[row, column]
    size_px = np.array([camera.intrinsics.image_size_px for camera in rows.scene.cameras])[frame % cameras]
    boxes_px = clip(corner_form(np.maximum(place[row, column], [-np.inf, -np.inf, 1, 1])), size_px)
    return Tracks.of(
        cameras,
        frame,
        spans.identity[column],
        at_least_a_pixel(boxes_px, size_px),
        hits.label[last],
        np.where(seen, hits.confidence[last], np.nan),
        variance[row, column, :2, None] * np.eye(2),
    )


@dataclass(frozen=True, eq=False)
class IdentitySpans:
    """The frames of I identities from the first detection of each to its last, in rows 0 to at most L − 1."""

    identity: Indices  # shape (I,)
    frame: Indices  # number of the frame; `NOBODY` after the last detection, shape (L, I)
    detection: Indices  # row of the detection in the frame; `NOBODY` where there is none, shape (L, I)
    sequences: BoxSequences  # the detected boxes

    @classmethod
    def of(cls, rows: RunRows, provenance: DetectionSources) -> IdentitySpans:
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


SMOOTHED, RAW = "smoothed", "raw"
REFERENCES = {SMOOTHED: "oracle association, smoothed", RAW: "oracle association, raw boxes"}  # what tables call them


def reference_tracks(rows: RunRows, rules: Rules) -> dict[str, Tracks]:
    """The tracks of the references, by their keys."""
    truth = TrueTracks.of(rows, rules.truth, rules.gap_s)
    return {name: oracle_tracks(rows, truth, smoothed=name == SMOOTHED) for name in REFERENCES}
