"""Runs whose single numbers are right and whose draws are not independent, made from a true run's detections."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import at_least_a_pixel, clip, inside_image, move
from modsim3d.detector.records import FALSE_POSITIVE, TRUE, Detections
from modsim3d.verify.evidence import CameraEvidence, Evidence

Lie = Callable[[Evidence], list[Detections]]


def told(lie: Lie, evidence: Evidence) -> Evidence:
    """The run as the lie has it."""
    pairs = zip(evidence.cameras, lie(evidence), strict=True)
    return Evidence.of([replace(seen, detections=detections) for seen, detections in pairs])


def single(seen: CameraEvidence) -> Indices:
    """Rows of detections that are one box of one vessel."""
    return np.flatnonzero(seen.detections.kind == TRUE)


def places(seen: CameraEvidence, rows: Indices) -> Indices:
    """Step and vessel of detections as one number each."""
    target = seen.detections.target[rows]
    return seen.frames.steps[seen.targets.frame[target]] * 1000 + seen.targets.vessel[target]


def with_errors(seen: CameraEvidence, rows: Indices, errors_px: Array) -> Detections:
    """Other errors of some detections, and the boxes that follow from them; small ones where they leave no box."""
    found, image = seen.detections, seen.frames.image_size_px
    true = at_least_a_pixel(seen.targets.boxes_px[found.target[rows]], image)
    errors_px = np.where(inside_image(move(true, errors_px), image)[:, None], errors_px, found.errors_px[rows])
    small = 1e-3 * np.random.default_rng(0).standard_normal(errors_px.shape)
    errors_px = np.where(inside_image(move(true, errors_px), image)[:, None], errors_px, small)
    errors, boxes = found.errors_px.copy(), found.boxes_px.copy()
    errors[rows], boxes[rows] = errors_px, clip(move(true, errors_px), image)
    return replace(found, errors_px=errors, boxes_px=boxes)


def in_frames(found: Detections, frame: Indices, **columns: Array) -> Detections:
    """Detections moved to other frames, in the order of these."""
    order = np.argsort(frame, kind="stable")
    names = ("target", "partner", "kind", "label", "confidence", "boxes_px", "errors_px", "redrawn")
    values = {name: columns.get(name, getattr(found, name))[order] for name in names}
    return replace(found, frame=frame[order], **values)


def copied(seen: CameraEvidence, rows: Indices, of: CameraEvidence, those: Indices, apart: int, share: float):
    """The errors of other detections, so many steps earlier, of the same vessels where there are some. Of the variance
    a share is theirs, the rest that of the own errors."""
    wanted, known = places(seen, rows) - 1000 * apart, places(of, those)
    order = np.argsort(known)
    place = np.minimum(np.searchsorted(known[order], wanted), len(known) - 1)
    same = np.flatnonzero(known[order[place]] == wanted)
    rows, those = rows[same], those[order[place[same]]]
    own, theirs = seen.detections.errors_px[rows], of.detections.errors_px[those]
    if share == 1:
        return with_errors(seen, rows, theirs)
    mean = of.detections.errors_px[single(of)].mean(axis=0)
    return with_errors(seen, rows, mean + (1 - share) ** 0.5 * (own - mean) + share**0.5 * (theirs - mean))


def same_errors_in_both_cameras(evidence: Evidence, share: float = 1.0) -> list[Detections]:
    first, second = evidence.cameras
    return [first.detections, copied(second, single(second), first, single(first), 0, share)]


def second_half_repeats_the_first(evidence: Evidence, share: float = 1.0) -> list[Detections]:
    half = max(int(seen.frames.steps[-1]) for seen in evidence.cameras) // 2
    result = []
    for seen in evidence.cameras:
        rows = single(seen)
        late = seen.frames.steps[seen.detections.frame[rows]] >= half
        result.append(copied(seen, rows[late], seen, rows[~late], half, share))
    return result


def same_errors_in_an_image(seen: CameraEvidence) -> Detections:
    rows = single(seen)
    _, first, of = np.unique(seen.detections.frame[rows], return_index=True, return_inverse=True)
    return with_errors(seen, rows, seen.detections.errors_px[rows[first[of]]])


def larger_and_larger_errors(seen: CameraEvidence) -> Detections:
    rows = single(seen)
    errors = seen.detections.errors_px[rows]
    distance = (((errors - errors.mean(axis=0)) / errors.std(axis=0)) ** 2).sum(axis=1)
    return with_errors(seen, rows, errors[np.argsort(distance)])


def confidence_in_order(seen: CameraEvidence, within_s: float) -> Detections:
    found = seen.detections
    span = seen.frames.times_s[found.frame] // within_s
    return replace(found, confidence=found.confidence[np.lexsort((found.confidence, span))])


def false_positives_at(seen: CameraEvidence, places: Callable[[int], Array]) -> Detections:
    """The same false positives at other places, as parts of how many are expected up to each frame."""
    found, frame = seen.detections, seen.detections.frame.copy()
    rows = np.flatnonzero(found.kind == FALSE_POSITIVE)
    expected = np.cumsum(np.bincount(frame[~found.false()], minlength=len(seen.frames))).astype(np.float64)
    frame[rows] = np.searchsorted(expected, places(len(rows)) * expected[-1])
    return in_frames(found, frame)


def of_each(change: Callable[..., Detections], **options: object) -> Lie:
    """The lie that changes what each camera has seen by itself."""
    return lambda evidence: [change(seen, **options) for seen in evidence.cameras]


def in_threes(count: int) -> Array:
    return np.random.default_rng(0).random(count // 3 + 1)[np.arange(count) // 3]


def same_misses_in_both_cameras(evidence: Evidence) -> list[Detections]:
    """In the second camera as many misses as before, of the vessels that the first one misses as far as they go."""
    first, second = evidence.cameras
    chances = [seen.frames.steps[seen.targets.frame] * 1000 + seen.targets.vessel for seen in (first, second)]
    missed = np.setdiff1d(chances[0], chances[0][first.detections.target[~first.detections.false()]])
    found = second.detections
    rows = np.flatnonzero(~found.false())
    rank = np.where(np.isin(chances[1], missed), 0, 1) + np.random.default_rng(0).random(len(chances[1]))
    seen_now = np.sort(np.argsort(rank)[len(rank) - len(rows) :])
    target, frame = found.target.copy(), found.frame.copy()
    target[rows], frame[rows] = seen_now, second.targets.frame[seen_now]
    fitting = with_errors(replace(second, detections=replace(found, target=target)), rows, found.errors_px[rows])
    columns = {"target": target, "boxes_px": fitting.boxes_px, "errors_px": fitting.errors_px}
    return [first.detections, in_frames(found, frame, **columns)]


TWICE, CAMERAS = "box errors: none comes twice", "box errors: correlation between cameras"
EARLIER = "box errors: correlation with earlier times"
ORDERED, FALSE = "confidence: correlation with earlier times", "false positives: variance over mean in"

LIES: dict[str, tuple[Lie, set[str]]] = {
    "same errors in both cameras": (same_errors_in_both_cameras, {TWICE, CAMERAS}),
    "similar errors in both cameras": (partial(same_errors_in_both_cameras, share=0.1), {CAMERAS}),
    "the second half repeats the first": (second_half_repeats_the_first, {TWICE, EARLIER}),
    "the second half resembles the first": (partial(second_half_repeats_the_first, share=0.4), {EARLIER}),
    "same errors in an image": (of_each(same_errors_in_an_image), {TWICE, "box errors: correlation within images"}),
    "larger and larger errors": (of_each(larger_and_larger_errors), {"box errors: order in time"}),
    "same misses in both cameras": (same_misses_in_both_cameras, {"misses: correlation between cameras"}),
    "confidence in order": (of_each(confidence_in_order, within_s=np.inf), {"confidence: order in time", ORDERED}),
    "confidence in order within minutes": (of_each(confidence_in_order, within_s=60), {ORDERED}),
    "even false positives": (
        of_each(false_positives_at, places=lambda count: (np.arange(count) + 0.5) / count),
        {f"{FALSE} stretches"},
    ),
    "false positives in threes": (of_each(false_positives_at, places=in_threes), {f"{FALSE} images"}),
}
"""Each lie, and the checks that must find it."""
