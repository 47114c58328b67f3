"""Checks of where false positives are, how large they are, and how long persistent ones live."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import centres, sizes, unions
from modsim3d.detector.chain import clutter_of
from modsim3d.detector.draws import select
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.parts import Part
from modsim3d.detector.persistent_clutter import persistent_clutter
from modsim3d.detector.placement import DRAWS
from modsim3d.detector.records import FALSE_POSITIVE, PERSISTENT, CameraFrames, Targets
from modsim3d.random_streams import Streams
from modsim3d.verify.evidence import CameraEvidence, Evidence, unknown_rest_note
from modsim3d.verify.law_measures import Law
from modsim3d.verify.measures import CORRELATION, Estimate
from modsim3d.verify.parameters import Parameter

LEAST_FALSE = 50
LEAST_LIFETIMES = 20
"""Least length of a run in lifetimes, times the mean number at a time, for which lifetimes are tested."""
_DRAWS_EACH = 40
_REPLAYS = 150
_DIGITS = 6  # decimals of a pixel: equal sides that were read back from centre and size stay equal


def clutter_box_checks(model: DetectorModel, evidence: Evidence, persistent: Array) -> list[Parameter]:
    """Places and sizes of transient false positives, and the lifetime of persistent ones.

    `persistent` is the expected number of persistent ones in each frame, shape (s,).
    """
    note = unknown_rest_note(model, evidence)
    names = ("placement[below the horizon]", "placement[along the horizon]", "size[width]", "size[height]")
    laws = [None] * len(names) if note else _laws(model, evidence)
    parameters = [
        Parameter(f"false_positives.{name}", Part.FALSE_POSITIVES, law, 0.0, note=note)
        for name, law in zip(names, laws, strict=True)
    ]
    if model.clutter.persistent_share:
        lifetime = None if note else _lifetime(model, evidence, persistent)
        note = note or "as the correlation of their number from one frame to the next"
        name = "false_positives.persistence.lifetime_s"
        parameters.append(Parameter(name, Part.FALSE_POSITIVES, lifetime, note=note))
    return parameters


def _laws(model: DetectorModel, evidence: Evidence) -> list[Law] | list[None]:
    """Distance of each column of `_places_and_sizes` from many draws in the same frames (Smirnov (1939))."""
    source, rng = clutter_of(model, evidence.census(model)), np.random.default_rng(0)
    found, drawn = [], []
    for seen in evidence.cameras:
        rows = np.flatnonzero(seen.detections.kind == FALSE_POSITIVE)
        frame = seen.detections.frame[rows]
        found.append(_places_and_sizes(seen.frames, frame, seen.detections.boxes_px[rows]))
        again = np.repeat(frame, _DRAWS_EACH)
        boxes = source.boxes_px(seen.frames, _kept(seen), again, rng.random((len(again), DRAWS + 1)))
        drawn.append(_places_and_sizes(seen.frames, again, boxes))
    values, expected = np.concatenate(found), np.concatenate(drawn)
    if len(values) < LEAST_FALSE:
        return [None] * 4
    worth = len(values) * _DRAWS_EACH // (_DRAWS_EACH + 1)  # the draws too are a sample
    return [Law(_distance(values[:, k], expected[:, k]), worth) for k in range(4)]


def _kept(seen: CameraEvidence) -> Targets:
    """The detected vessels as the detector had them, with merged ones in one box."""
    found = seen.detections
    true = np.flatnonzero(~found.false())
    true = true[np.argsort(found.frame[true], kind="stable")]
    kept = select(seen.targets, found.target[true])
    merged = np.flatnonzero(found.partner[true] >= 0)
    boxes = kept.boxes_px.copy()
    boxes[merged] = unions(boxes[merged], seen.targets.boxes_px[found.partner[true[merged]]])
    return replace(kept, boxes_px=boxes)


def _places_and_sizes(frames: CameraFrames, frame: Indices, boxes_px: Array) -> Array:
    """Depth of the middle below the horizon, place along it, width, height; in pixels, shape (m, 4)."""
    a, b, c = frames.sea_half_planes[frame].T
    length = np.hypot(a, b)
    x, y = centres(boxes_px).T
    some, level = np.where(length > 0, length, 1), length == 0  # without a horizon: depth below the upper edge
    below = np.where(level, y, (a * x + b * y + c) / some)
    along = np.where(level, x, (b * x - a * y) / some)
    return np.round(np.column_stack([below, along, sizes(boxes_px)]), _DIGITS)


def _distance(found: Array, expected: Array) -> float:
    """Greatest distance between two empirical distribution functions."""
    places = np.concatenate([found, expected])
    shares = [np.searchsorted(np.sort(each), places, side="right") / len(each) for each in (found, expected)]
    return float(np.abs(shares[0] - shares[1]).max())


def _lifetime(model: DetectorModel, evidence: Evidence, persistent: Array) -> Estimate | None:
    """Estimate ρ = e^(−Δt/lifetime) from how much the number of persistent ones changes from frame to frame.

    With m expected in one frame and m' in the next, the mean square change of the number less its expectation is
    m + m' − 2ρ·min(m, m'). Replays of the process give the standard error.
    """
    images, lifetime = evidence.frames, model.clutter.lifetime_s
    rows = np.flatnonzero(persistent > 0)
    same = images.camera[rows][1:] == images.camera[rows][:-1]
    now, before = rows[1:][same], rows[:-1][same]
    if not len(now):
        return None
    apart = images.time_s[now] - images.time_s[before]
    common = np.minimum(persistent[now], persistent[before])
    if float((common * apart).sum()) < LEAST_LIFETIMES * lifetime:
        return None

    def correlation(numbers: Array) -> float:
        surplus = numbers - persistent
        changes = (surplus[now] - surplus[before]) ** 2
        return float((persistent[now] + persistent[before] - changes).sum() / (2 * common.sum()))

    counts = [
        np.bincount(s.detections.frame[s.detections.kind == PERSISTENT], minlength=len(s.frames))
        for s in evidence.cameras
    ]
    asked = float((np.exp(-apart / lifetime) * common).sum() / common.sum())
    replays = np.array([correlation(_replayed(evidence, persistent, lifetime, seed)) for seed in range(_REPLAYS)])
    error = float(replays.std())
    if error <= 0:
        return None
    skewness = float(((replays - replays.mean()) ** 3).mean()) / error**3
    return Estimate(correlation(np.concatenate(counts)), asked, error, len(now), skewness, possible=CORRELATION)


def _replayed(evidence: Evidence, persistent: Array, lifetime_s: float, seed: int) -> Array:
    """Number of persistent false positives in each frame with another seed, shape (s,)."""
    numbers, streams, first = [], Streams(seed), 0
    for seen in evidence.cameras:
        means = persistent[first : first + len(seen.frames)]
        shown = persistent_clutter(streams, seen.frames, means, lifetime_s)
        numbers.append(np.bincount(shown.frame, minlength=len(means)))
        first += len(means)
    return np.concatenate(numbers)
