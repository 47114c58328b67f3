"""What average precision is lost to, one kind of error at a time (after Bolya et al. (2020), "TIDE").

A false detection of a label is, by its largest overlap with truth: `classification` (well placed, another label),
`localisation` (right label, ill placed), `both`, `duplicate` (of what a surer one has found) or `background`; a truth
that no detection comes near is `missed`. Each share is by how much mean average precision would rise if that kind alone
were mended.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.learn.average_precision import Curve
from modsim3d.learn.labelled import NOBODY, LabelledSet
from modsim3d.learn.matching import Rule, image_pairs, match, overlap

KINDS = ("classification", "localisation", "both", "duplicate", "background", "missed")
BACKGROUND_IOU = 0.1


@dataclass(frozen=True, eq=False)
class ErrorShares:
    """What each kind costs.

    Attributes:
        average_precision: Mean over labels, as it is, by all points.
        gains: Points of mean average precision for each of `KINDS`, in hundredths.
        counts: How many errors of each kind.
    """

    average_precision: float
    gains: dict[str, float]
    counts: dict[str, int]


@dataclass(frozen=True, eq=False)
class _Nearest:
    """For each detection its best truth of the same and of another label, and how well they overlap."""

    same: Indices
    same_iou: Array
    other: Indices
    other_iou: Array


def error_shares(
    labelled: LabelledSet, images: Mask, least_iou: float = 0.5, least_confidence: float = 0.0
) -> ErrorShares:
    """The shares over some images, at one IoU.

    Args:
        labelled: What was found.
        images: Which images, shape (I,).
        least_iou: Less is no match.
        least_confidence: Of detections that take part.
    """
    found, truth = labelled.results, labelled.annotations
    matched = match(labelled, Rule(least_iou=least_iou, by_label=True), least_confidence)
    counts = matched.counts & images[found.image]
    sought = matched.sought & images[truth.image]
    right = counts & (matched.annotation >= 0)
    false = np.flatnonzero(counts & ~right)
    near = _nearest(labelled, false, sought)
    kind = _kinds(near, least_iou)
    taken = np.zeros(len(truth), dtype=bool)
    taken[matched.annotation[right]] = True
    covered = taken.copy()
    covered[near.other[kind == 0]] = True
    covered[near.same[kind == 1]] = True
    missed = sought & ~covered
    state = _State(labelled, counts, right, found.label, sought)
    plain = state.mean_precision()
    gains = {}
    for index, name in enumerate(KINDS):
        ours = false[kind == index]
        if name == "classification":
            mended = state.mended(ours, near.other[kind == 0], taken)
        elif name == "localisation":
            mended = state.mended(ours, near.same[kind == 1], taken)
        elif name == "missed":
            mended = _State(labelled, counts, right, found.label, sought & ~missed)
        else:
            mended = state.without(ours)
        gains[name] = 100 * (mended.mean_precision() - plain)
    tallies = {name: int((kind == index).sum()) for index, name in enumerate(KINDS[:-1])}
    return ErrorShares(plain, gains, tallies | {"missed": int(missed.sum())})


def _nearest(labelled: LabelledSet, rows: Indices, sought: Mask) -> _Nearest:
    """Best truths of some detections, −1 where nothing overlaps."""
    found, truth, size = labelled.results, labelled.annotations, len(rows)
    best = {same: (np.full(size, NOBODY), np.zeros(size)) for same in (True, False)}
    columns = np.flatnonzero(sought)
    for first, second in image_pairs(found.image[rows], truth.image[columns], len(labelled.images)):
        target = columns[second]
        value = overlap(found.boxes_px[rows[first]], truth.boxes_px[target], truth.crowd[target])
        equal = found.label[rows[first]] == truth.label[target]
        for same, (where, how) in best.items():
            ours = np.flatnonzero((equal == same) & (value > 0))
            order = ours[np.argsort(value[ours], kind="stable")]
            where[first[order]], how[first[order]] = target[order], value[order]  # the last, largest one stays
    return _Nearest(*best[True], *best[False])


def _kinds(near: _Nearest, least_iou: float) -> Indices:
    """Index into `KINDS` of each false detection; a localisation error comes before one of the label."""
    conditions = [
        near.same_iou >= least_iou,
        near.same_iou >= BACKGROUND_IOU,
        near.other_iou >= least_iou,
        near.other_iou >= BACKGROUND_IOU,
    ]
    return np.select(conditions, [3, 1, 0, 2], default=4)


@dataclass(frozen=True, eq=False)
class _State:
    """Detections as they are, or with something mended."""

    labelled: LabelledSet
    counts: Mask
    right: Mask
    label: Indices
    sought: Mask

    def mean_precision(self) -> float:
        """Mean average precision over the labels that are there, by all points."""
        found, truth, values = self.labelled.results, self.labelled.annotations, []
        for label in range(len(self.labelled.labels)):
            total = int((self.sought & (truth.label == label)).sum())
            if not total:
                continue
            rows = np.flatnonzero(self.counts & (self.label == label))
            rows = rows[np.argsort(-found.confidence[rows], kind="stable")]
            right = np.cumsum(self.right[rows])
            recall = np.minimum(right / total, 1.0)
            values.append(Curve(recall, right / np.arange(1, len(rows) + 1), found.confidence[rows]).all_points())
        return float(np.mean(values)) if values else 0.0

    def without(self, rows: Indices) -> _State:
        """Some detections left out."""
        counts = self.counts.copy()
        counts[rows] = False
        return _State(self.labelled, counts, self.right, self.label, self.sought)

    def mended(self, rows: Indices, truths: Indices, taken: Mask) -> _State:
        """Some detections made right: the surest of each truth that nothing has found; the others are left out."""
        free = ~taken[truths]
        order = np.argsort(-self.labelled.results.confidence[rows[free]], kind="stable")
        rows_free, truths_free = rows[free][order], truths[free][order]
        _, first = np.unique(truths_free, return_index=True)
        chosen = rows_free[first]
        right, counts, label = self.right.copy(), self.counts.copy(), self.label.copy()
        counts[rows] = False
        counts[chosen], right[chosen] = True, True
        label[chosen] = self.labelled.annotations.label[truths_free[first]]
        return _State(self.labelled, counts, right, label, self.sought)
