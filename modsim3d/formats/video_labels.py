"""Labels of a video as the truth of a scene, with a real detector's results or what a simulated one needs."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices
from modsim3d.core.boxes import clip, sizes
from modsim3d.core.errors import InputError
from modsim3d.detector.model import DetectorModel
from modsim3d.formats.labelled import FileIds, LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.video_targets import TargetBoxes, Video
from modsim3d.world.poses.labelled import (
    REAL,
    GivenDetections,
    IgnoredRegions,
    ImageSequence,
    LabelledBoxes,
    LabelledPoses,
)


def labels_of(
    labelled: LabelledSet,
    videos: Sequence[Video],
    sought: TargetBoxes,
    ids: FileIds,
    labels: Sequence[str],
    to_label: Indices,
    sea: Array | None,
    source: str,
    given: bool,
) -> LabelledPoses:
    """Labels of videos as a scene has them. `ids` names tracks and images as the file does, `labels` are the detector's
    and `to_label` the one of each class: (k,), `sea` the half-plane below the horizon: (3,), None if it is not known;
    `source` names the file in errors; `given` takes the detections of the labelled set. Raises InputError if tracks
    cannot be told apart."""
    place = _Places(videos, len(labelled.images))
    used, vessel = np.unique(sought.track, return_inverse=True)
    named = np.array([str(ids.identities[track]) for track in used.tolist()], dtype=object)
    if len(set(named)) < len(named):
        raise InputError(source, ["tracks of one name that are a number here and a text there: give all one form"])
    order = np.argsort(named, kind="stable")
    rank = np.empty(len(named), dtype=np.int64)
    rank[order] = np.arange(len(named))
    counts = np.zeros((len(named), len(labels)), dtype=np.int64)
    np.add.at(counts, (vessel, sought.label), 1)
    turning = int((np.count_nonzero(counts, axis=1) > 1).sum())
    notes = [f"{turning} of {len(named)} tracks change their class, and have the one of most of their boxes"]
    of_vessel = [labels[label] for label in counts.argmax(axis=1)[order].tolist()]
    step, camera = place.of(sought.image)
    by_place = np.lexsort((rank[vessel], camera, step))
    columns = sought.visible_fraction, sought.depth_m, sought.in_frame_fraction
    boxes = LabelledBoxes(step, camera, rank[vessel], sought.boxes_px, *columns).take(by_place)
    row_of = np.full(len(labelled.annotations), NOBODY)
    row_of[sought.rows[by_place]] = np.arange(len(boxes))
    detections, remarks = _detections(labelled, row_of, to_label, place) if given else (None, [])
    return LabelledPoses(
        tuple(map(repr, place.times_s.tolist())),
        tuple(
            ImageSequence(
                video.file_name,
                video.size_px,
                steps,
                tuple(str((ids.files or ids.images)[image]) for image in video.images.tolist()),
                None if sea is None else tuple(sea.tolist()),
                ids.first_frame,
            )
            for video, steps in zip(videos, place.steps, strict=True)
        ),
        dict(zip(named[order].tolist(), of_vessel, strict=True)),
        boxes,
        _regions(labelled, place),
        detections,
        (*labelled.notes, *sought.notes, *(notes if turning else ()), *remarks),
    )


class _Places:
    """Steps and cameras of the images of some videos; each time of an image is a step."""

    def __init__(self, videos: Sequence[Video], count: int) -> None:
        """Number the times of all `count` images."""
        self.times_s = np.unique(np.concatenate([video.times_s for video in videos]))
        self.steps = [np.searchsorted(self.times_s, video.times_s) for video in videos]
        self._step, self._camera = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        for camera, (video, steps) in enumerate(zip(videos, self.steps, strict=True)):
            self._step[video.images], self._camera[video.images] = steps, camera

    def of(self, image: Indices) -> tuple[Indices, Indices]:
        """Step and camera of some images, by their rows, shapes (n,)."""
        return self._step[image], self._camera[image]


def _regions(labelled: LabelledSet, place: _Places) -> IgnoredRegions:
    rows = labelled.annotations
    boxes_px = clip(rows.boxes_px, labelled.images.sizes_px[rows.image])
    kept = np.flatnonzero((rows.ignored | rows.crowd) & (sizes(boxes_px) > 0).all(axis=1))
    step, camera = place.of(rows.image[kept])
    return IgnoredRegions(step, camera, boxes_px[kept], rows.crowd[kept]).take(np.lexsort((camera, step)))


def _detections(
    labelled: LabelledSet, row_of: Indices, to_label: Indices, place: _Places
) -> tuple[GivenDetections, list[str]]:
    """Detections of a real detector, cut at the edge of the image, and remarks. `row_of` has the row of each annotation
    among the boxes of the scene, shape (T,), `to_label` the detector's label of each class: (k,). Those of a class that
    is no target, or that match what is to be ignored, are left out, as evaluations leave them out."""
    results = labelled.results
    if np.isnan(results.confidence).any() and not np.isnan(results.confidence).all():
        raise InputError("detections", ["some have a confidence, and others have none"])
    boxes_px = clip(results.boxes_px, labelled.images.sizes_px[results.image])
    matched = match(labelled, Rule("confidence" if labelled.scored else "optimal"))
    row = np.append(row_of, NOBODY)[matched.annotation]  # the last is that of none
    usable = matched.counts & ((matched.annotation < 0) | (row >= 0)) & (to_label[results.label] >= 0)
    kept = np.flatnonzero((sizes(boxes_px) > 0).all(axis=1) & usable)
    step, camera = place.of(results.image)
    confidence = np.nan_to_num(results.confidence, nan=1.0)
    detections = GivenDetections(step, camera, to_label[results.label], boxes_px, confidence, row).take(kept)
    notes = []
    if left := int((~usable).sum()):
        notes.append(f"{left:,} of {len(results):,} detections are left out: they lie where nothing counts")
    if not labelled.scored:
        notes.append("the detections have no confidence: 1 stands for it")
    return detections.take(np.lexsort((-detections.confidence, detections.camera, detections.step))), notes


def given_detector(labels: Sequence[str]) -> dict[str, Any]:
    """Content of a detector file with these labels, for a scene with given detections: it is never asked."""
    count = len(labels)
    state = {
        "confusion": [*np.eye(count).tolist(), [0.0] * count],
        "false_positive_labels": [1 / count] * count,
        "false_discovery_rate": 0.0,
        "box_error": {"unit": "px", "mean": [0.0] * 4, "covariance": np.eye(4).tolist()},
        "confidence": {"true": {"mean": 0.5, "std": 0.1}, "false": {"mean": 0.5, "std": 0.1}},
    }
    return {
        "labels": list(labels),
        "confidence_threshold": 0.0,
        "initial_state": REAL,
        "transition_matrix": [[1.0]],
        "states": {REAL: state},
    }


def check_needs(model: DetectorModel, source: str, depth_m: Array, horizon: Array | None) -> list[str]:
    """Remarks on what is left out. `source` is what messages call the detector's file, `depth_m` the distance of each
    target, NaN where unknown: (n,), `horizon` the half-plane of the sea: (3,), None if it is not known. Raises
    InputError if the detector asks for what is not known."""
    problems = list(_distance_problems(model, depth_m))
    if horizon is None:
        problems += _horizon_problems(model)
    if problems:
        raise InputError(source, problems)
    placement = model.false_positives.placement
    rates = (getattr(state, model.false_positives.numbers.rate_key) for state in model.states)
    if horizon is not None or placement.density is not None or not any(rate > 0 for rate in rates):
        return []
    return ["false positives lie anywhere in the image, also in the sky: --horizon would keep them on the sea"]


def _distance_problems(model: DetectorModel, depth_m: Array) -> Iterator[str]:
    unknown = int(np.isnan(depth_m).sum())
    if not unknown:
        return
    needed = (
        f"needs the distance of every vessel, which {unknown} of {len(depth_m)} boxes do not have: give distance_m of "
        "each annotation of a COCO file (MOT has no such column), or leave it out with "
    )
    if model.gates.max_range_m is not None:
        yield f"gates.max_range_m: {needed}--set detector.gates.max_range_m=null"
    keys = [] if not any(effect.attribute == "distance_m" for effect in model.dropout.effects) else ["dropout"]
    keys += [
        f"states.{model.states[state].name}.dropout"
        for state, effects in model.dropout.own.items()
        if any(effect.attribute == "distance_m" for effect in effects)
    ]
    if keys:
        without = " ".join(f"--set detector.{key}.distance_m=null" for key in keys)
        if {effect.attribute for effect in model.dropout.every_effect} == {"distance_m"}:
            without += " --set detector.dropout.model=confusion"
        yield f"{keys[0]}.distance_m: {needed}{without}"


def _horizon_problems(model: DetectorModel) -> Iterator[str]:
    placement = model.false_positives.placement
    needed = "needs the horizon: give --horizon ROW, or X1,Y1,X2,Y2 where it is tilted, or leave it out with "
    if placement.band_px is not None:
        without = "--set detector.false_positives.placement=uniform --set detector.false_positives.band_px=null"
        yield f"false_positives.placement: horizon_band {needed}{without}"
    if placement.far_half_px is not None:
        yield f"false_positives.far_half_px: {needed}--set detector.false_positives.far_half_px=null"
