"""By how much matching shifts what is learned, found by simulation.

A matching rule cuts off large errors: a box too far off counts as a miss and a false detection. To see how much that
shifts the numbers, the learned detector is simulated over the same annotations and learned again by the same rule.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask, run_starts
from modsim3d.core.errors import ModsimError
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel, Performance
from modsim3d.detector.records import FALSE_KINDS, CameraFrames, Targets
from modsim3d.formats.labelled import EVERYWHERE, LabelledSet, Results
from modsim3d.formats.matching import match
from modsim3d.learn.bootstrap import Column, Entry, Kind, entries_of, from_scale, spread, to_scale, with_entries
from modsim3d.learn.learned import Learned, LearnSettings, learn_again

SURE = 0.05
"""Probability that any shift is called sure by chance alone."""


@dataclass(frozen=True, eq=False)
class BiasPart:
    """Images of one sequence and size, as the detector takes them: frames and targets.

    With the rows of the images (S,), of the annotations in them that count (n,), and the state in each frame (S,).
    """

    images: Indices
    rows: Indices
    frames: CameraFrames
    targets: Targets
    states: Indices


def parts_of(labelled: LabelledSet, image_state: Indices) -> Iterator[BiasPart]:
    """Split all images that have a state, shape (I,), by sequence and size.

    Raises:
        ModsimError: The size of an image is not known.
    """
    images, annotations = labelled.images, labelled.annotations
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
        rows = np.flatnonzero((place[annotations.image] >= 0) & ~annotations.ignored)
        rows = rows[np.argsort(place[annotations.image[rows]], kind="stable")]
        frame = place[annotations.image[rows]]
        ordinal = np.arange(len(rows)) - np.searchsorted(frame, frame)
        identity = annotations.identity[rows]
        known = identity >= 0
        names, vessel = np.unique(np.where(known, identity, -1 - ordinal), return_inverse=True)
        given = images.half_planes[ours]
        half_planes = np.where(np.isnan(given), EVERYWHERE, given)
        size = (int(key[1]), int(key[2]))
        yield BiasPart(
            ours,
            rows,
            CameraFrames(f"sequence {number}", np.arange(len(ours)), times, size, half_planes),
            Targets(
                frame=frame,
                vessel=vessel.ravel(),
                label=annotations.label[rows],
                boxes_px=np.clip(annotations.boxes_px[rows], 0, [*size, *size]),
                visible_fraction=annotations.visible_fraction[rows],
                depth_m=annotations.depth_m[rows],
                vessel_ids=tuple(f"{name}" for name in names.tolist()),
            ),
            image_state[ours],
        )


def simulated(labelled: LabelledSet, image_state: Indices, model: DetectorModel, seed: int) -> LabelledSet:
    """Labelled set with the results of a simulated detector, in states of images of shape (I,)."""
    parts = list(parts_of(labelled, image_state))
    census = target_statistics(model, ((part.frames, part.targets) for part in parts))
    columns: list[Results] = []
    for part in parts:
        times = part.frames.times_s
        changes = run_starts(part.states)
        schedule = tuple((float(times[k]), int(part.states[k])) for k in changes)
        held = replace(model, performance=Performance(True, schedule), transition_interval_s=None)

        def clock(first: int, stop: int, times: Array = times) -> Array:
            return times[first:stop]

        drawn = Detector(held, seed, census, clock).detect(part.frames, part.targets)
        own = ~np.isin(drawn.kind, FALSE_KINDS) & (drawn.target >= 0)
        columns.append(
            Results(
                image=part.images[drawn.frame],
                label=drawn.label,
                boxes_px=drawn.boxes_px,
                confidence=drawn.confidence,
                origin=np.where(own, np.append(part.rows, NOBODY)[drawn.target], NOBODY),
                kind=drawn.kind,
                partner=np.append(part.rows, NOBODY)[drawn.partner],
            )
        )
    names = ("image", "label", "boxes_px", "confidence", "origin", "kind", "partner")
    whole = Results(**{name: np.concatenate([getattr(part, name) for part in columns]) for name in names})
    return replace(labelled, results=whole.by_image())


@dataclass(frozen=True, eq=False)
class Shift:
    """Mean shift of an entry with its standard error, on the scale on which it is nearly normal; of the entry's shape.

    `again` is the mean of what was learned again, on the plain scale.
    """

    entry: Entry
    shift: Array
    error: Array
    again: Array

    @classmethod
    def of(cls, entry: Entry, runs: Array) -> Shift:
        """From what was learned again, shape (repeats, ...); NaN where fewer than two repeats tell the number."""
        kind = _scale(entry.column)
        scaled = to_scale(runs, kind)
        told = np.isfinite(scaled)
        number = told.sum(axis=0)
        enough = (number > 1) & np.isfinite(to_scale(entry.estimate, kind))
        mean = np.where(told, scaled, 0.0).sum(axis=0) / np.maximum(number, 1)
        shift = np.where(enough, mean - to_scale(entry.estimate, kind), 0.0)
        error = np.maximum(spread(scaled), _least_error(entry.column)) / np.sqrt(np.maximum(number, 1))
        return cls(entry, shift, np.where(enough, error, np.nan), np.where(enough, from_scale(mean, kind), np.nan))

    @property
    def corrected(self) -> Array:
        """The estimate less the shift, shape (...)."""
        kind = _scale(self.entry.column)
        moved = from_scale(to_scale(self.entry.estimate, kind) - self.shift, kind)
        least, most = _RANGES.get(self.entry.column.kind, (-np.inf, np.inf))
        return np.clip(moved, least, most)


@dataclass(frozen=True, eq=False)
class Bias:
    """By how much learning shifts each entry of what was learned, found by learning it again so often."""

    learned: Learned
    shifts: tuple[Shift, ...]
    repeats: int

    def significant(self, shift: Shift) -> Mask:
        """Mask of the numbers of an entry that are surely shifted, by Student's test of all together, shape (...)."""
        numbers = sum(np.size(each.shift) for each in self.shifts)
        needed = float(special.stdtrit(self.repeats - 1, 1 - SURE / (2 * numbers)))
        with np.errstate(invalid="ignore"):
            surely: Mask = np.isfinite(shift.error) & (np.abs(shift.shift) > needed * shift.error)
        return surely

    def corrected(self) -> Learned:
        """Learned numbers with the sure shifts taken off the estimates; replicates stay as they are."""
        shifts = iter(self.shifts)
        return replace(
            self.learned, numbers=with_entries(self.learned.numbers, lambda _: self._corrected(next(shifts)))
        )

    def _corrected(self, shift: Shift) -> Entry:
        values = shift.entry.column.values.copy()
        values[0] = np.where(self.significant(shift), shift.corrected, values[0])
        return replace(shift.entry, column=replace(shift.entry.column, values=values))


_RANGES = {"share": (0.0, 1.0), "rate": (0.0, np.inf)}


def _scale(column: Column) -> Kind:
    """The scale of the column; the plain one for shares and rates, which may be 0, where their own scales end."""
    return "mean" if column.kind in _RANGES else column.kind


def _least_error(column: Column) -> Array:
    """Least standard error on the plain scale, for shares and rates of what may have happened once or never."""
    value, count = column.estimate, np.maximum(column.counts, 1.0)
    if column.kind not in _RANGES:
        return np.full(value.shape, 1e-12)
    half_a_case = 0.5 / count
    rest = 1 - np.minimum(value, 1 - half_a_case) if column.kind == "share" else 1.0
    error: Array = np.sqrt(np.maximum(value, half_a_case) * rest * column.inflation / count)
    return error


def bias_of(learned: Learned, settings: LearnSettings, repeats: int = 12) -> Bias:
    """Simulate what was learned over its own data, learn it again, each time from another seed, and compare."""
    model, observed = parse_detector(learned.detector(), "what was learned"), learned.observed
    runs = []
    for k in range(repeats):
        labelled = simulated(observed.labelled, observed.image_state, model, settings.seed + 1 + k)
        matched = match(labelled, settings.rule, settings.threshold)
        again = learn_again(learned, replace(observed, labelled=labelled, matched=matched))
        runs.append([entry.estimate for entry in entries_of(again)])
    entries = entries_of(learned.numbers)
    shifts = tuple(Shift.of(entry, np.stack(found)) for entry, *found in zip(entries, *runs, strict=True))
    return Bias(learned, shifts, repeats)
