"""What matching does to what is learned, found by simulating.

A rule of matching cuts off large errors: a box too far off is a miss and a false detection. How much that shifts the
numbers is told by the detector itself: it is simulated over the very truth that it was learned from, and learned again
under the same rule.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from modsim3d.arrays import Array, Indices
from modsim3d.detector import Detector, reference_of
from modsim3d.detector.loader import parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.performance import Performance
from modsim3d.detector.records import FALSE_KINDS, Frames, Targets
from modsim3d.detector.reference import Reference
from modsim3d.errors import ModsimError
from modsim3d.learn.labelled import NOBODY, LabelledSet, Results
from modsim3d.learn.learned import Learned, Settings, Values, learn_again
from modsim3d.learn.resampling import Column, from_scale, spread, to_scale

SURE = 0.05
"""Chance that any bias at all is called sure by chance alone."""


@dataclass(frozen=True, eq=False)
class Part:
    """Images of one sequence and size, as the detector takes them.

    Attributes:
        images: Their rows, shape (S,).
        rows: Rows of the truth in them that count, shape (n,).
        frames: The frames.
        targets: Their truth.
        states: Of each frame, shape (S,).
    """

    images: Indices
    rows: Indices
    frames: Frames
    targets: Targets
    states: Indices


def parts_of(labelled: LabelledSet, image_state: Indices) -> Iterator[Part]:
    """All images with a state, split by sequence and size.

    Raises:
        ModsimError: The size of an image is not known.
    """
    images, truth = labelled.images, labelled.annotations
    used = np.flatnonzero(image_state >= 0)
    if not np.isfinite(images.sizes_px[used]).all():
        raise ModsimError("the detector cannot be simulated over images whose size is not known")
    keys = np.column_stack([images.sequence[used], images.sizes_px[used].astype(np.int64)])
    for number, key in enumerate(np.unique(keys, axis=0)):
        ours = used[(keys == key).all(axis=1)]
        timed = bool(np.isfinite(images.time_s[ours]).all())
        ours = ours[np.argsort(images.time_s[ours], kind="stable")] if timed else ours
        times = images.time_s[ours] if timed else np.arange(len(ours), dtype=np.float64)
        times = times - times[0]
        if len(times) > 1 and np.any(np.diff(times) <= 0):
            times = np.arange(len(ours), dtype=np.float64)
        place = np.full(len(images), NOBODY)
        place[ours] = np.arange(len(ours))
        rows = np.flatnonzero((place[truth.image] >= 0) & ~truth.ignored)
        rows = rows[np.argsort(place[truth.image[rows]], kind="stable")]
        frame = place[truth.image[rows]]
        ordinal = np.arange(len(rows)) - np.searchsorted(frame, frame)
        identity = truth.identity[rows]
        known = identity >= 0
        names, vessel = np.unique(np.where(known, identity, -1 - ordinal), return_inverse=True)
        half_planes = np.tile([0.0, 0.0, 1.0], (len(ours), 1))  # no horizon is known: sea everywhere
        size = (int(key[1]), int(key[2]))
        yield Part(
            ours,
            rows,
            Frames(f"sequence {number}", np.arange(len(ours)), times, size, half_planes),
            Targets(
                frame=frame,
                vessel=vessel.ravel(),
                label=truth.label[rows],
                boxes_px=np.clip(truth.boxes_px[rows], 0, [*size, *size]),
                visible_fraction=truth.visible_fraction[rows],
                depth_m=truth.depth_m[rows],
                vessel_ids=tuple(f"{name}" for name in names.tolist()),
            ),
            image_state[ours],
        )


def simulated(labelled: LabelledSet, image_state: Indices, model: DetectorModel, seed: int) -> LabelledSet:
    """The same images and truth, with what a detector puts out for them; states are those of the images."""
    parts = list(parts_of(labelled, image_state))
    reference = None
    if model.needs_reference:
        reference = sum((reference_of(model, part.frames, part.targets) for part in parts), Reference())
    columns: list[Results] = []
    for part in parts:
        times = part.frames.times_s
        changes = np.flatnonzero(np.diff(part.states, prepend=-1))
        schedule = tuple((float(times[k]), int(part.states[k])) for k in changes)
        held = replace(model, performance=Performance(True, schedule), transition_interval_s=None)

        def clock(first: int, stop: int, times: Array = times) -> Array:
            return times[first:stop]

        drawn = Detector(held, seed, clock=clock, reference=reference).detect(part.frames, part.targets)
        own = ~np.isin(drawn.kind, FALSE_KINDS) & (drawn.target >= 0)
        columns.append(
            Results(
                image=part.images[drawn.frame],
                label=drawn.label,
                boxes_px=drawn.boxes_px,
                confidence=drawn.confidence,
                origin=np.where(own, np.append(part.rows, NOBODY)[drawn.target], NOBODY),
            )
        )
    names = ("image", "label", "boxes_px", "confidence", "origin")
    whole = Results(**{name: np.concatenate([getattr(part, name) for part in columns]) for name in names})
    return replace(labelled, results=whole.by_image())


@dataclass(frozen=True, eq=False)
class Bias:
    """By how much learning shifts each number, on the scale on which it is nearly normal.

    Attributes:
        learned: What was learned.
        shifts: Mean shift, by path.
        errors: Its standard error, by path.
        again: Mean of what was learned again, by path, on the plain scale.
        repeats: How often it was.
    """

    learned: Learned
    shifts: Values
    errors: Values
    again: Values
    repeats: int

    def significant(self, path: str) -> np.ndarray:
        """Which numbers are surely shifted, by Student's test of all of them together."""
        numbers = sum(np.size(shift) for shift in self.shifts.values())
        needed = float(stats.t.ppf(1 - SURE / (2 * numbers), self.repeats - 1))
        with np.errstate(invalid="ignore"):
            return np.isfinite(self.errors[path]) & (np.abs(self.shifts[path]) > needed * self.errors[path])

    def corrected(self) -> Values:
        """The learned numbers less their bias, where that is sure."""
        values = self.learned.values()
        for path, shift in self.shifts.items():
            kind = _scale(self.learned.columns[path])
            moved = from_scale(to_scale(values[path], kind) - shift, kind)
            least, most = _RANGES.get(self.learned.columns[path].kind, (-np.inf, np.inf))
            values[path] = np.where(self.significant(path), np.clip(moved, least, most), values[path])
        return values


_RANGES = {"share": (0.0, 1.0), "rate": (0.0, np.inf)}


def _scale(column: Column) -> str:
    """Shares may be 0, where their usual scale ends: their bias is taken on the plain one."""
    return "mean" if column.kind in _RANGES else column.kind


def _least_error(column: Column) -> Array:
    """Standard error of a share or rate that may have happened once or never, on the plain scale."""
    value, count = column.estimate, np.maximum(column.counts, 1.0)
    if column.kind not in _RANGES:
        return np.full(value.shape, 1e-12)
    half_a_case = 0.5 / count
    rest = 1 - np.minimum(value, 1 - half_a_case) if column.kind == "share" else 1.0
    error: Array = np.sqrt(np.maximum(value, half_a_case) * rest * column.inflation / count)
    return error


def bias_of(
    learned: Learned, labelled: LabelledSet, image_state: Indices, settings: Settings, repeats: int = 12
) -> Bias:
    """Simulate what was learned, learn it again, and compare.

    Args:
        learned: What was learned.
        labelled: From what.
        image_state: Of each image.
        settings: As it was learned.
        repeats: How often, each with another seed.
    """
    model = parse_detector(learned.detector(), "what was learned")
    runs = [
        learn_again(learned, simulated(labelled, image_state, model, settings.seed + 1 + k), image_state, settings)
        for k in range(repeats)
    ]
    shifts, errors, again = {}, {}, {}
    for path, value in learned.values().items():
        kind = _scale(learned.columns[path])
        scaled = np.stack([to_scale(run[path], kind) for run in runs])
        moved = scaled - to_scale(value, kind)
        shifts[path] = np.nan_to_num(np.nanmean(np.where(np.isfinite(moved), moved, 0.0), axis=0))
        errors[path] = np.maximum(spread(scaled), _least_error(learned.columns[path])) / np.sqrt(repeats)
        again[path] = from_scale(scaled.mean(axis=0), kind)
    return Bias(learned, shifts, errors, again, repeats)
