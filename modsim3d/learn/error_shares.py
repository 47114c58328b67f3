"""What average precision is lost to, one kind of error at a time (after Bolya et al. (2020), "TIDE").

A false detection is classed by its largest overlap with annotations: `classification` (well placed, another label),
`localisation` (right label, badly placed), `both`, `duplicate` (of what a more confident one has detected) or
`background`. An annotation that no detection comes near is `missed`. The gain of a kind is how much mean average
precision would rise if errors of that kind alone were corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.labelled import NOBODY, LabelledSet
from modsim3d.formats.matching import Matched, image_pairs, overlap
from modsim3d.learn.average_precision import Curve


class ErrorKind(Enum):
    """A kind of error; the value is its name in reports."""

    CLASSIFICATION = "classification"
    LOCALISATION = "localisation"
    BOTH = "both"
    DUPLICATE = "duplicate"
    BACKGROUND = "background"
    MISSED = "missed"


BACKGROUND_IOU = 0.1
_KINDS = tuple(ErrorKind)


@dataclass(frozen=True)
class ErrorShare:
    """How many errors of a kind there are, and the hundredths of mean average precision that they cost."""

    kind: ErrorKind
    count: int
    gain_points: float


@dataclass(frozen=True)
class ErrorShares:
    """What mean average precision, over labels and by all points, is lost to: a share for each kind."""

    average_precision: float
    shares: tuple[ErrorShare, ...]


@dataclass(frozen=True, eq=False)
class _Nearest:
    """The best annotation of the same and of another label for each of n detections, with their IoU, shapes (n,)."""

    same: Indices
    same_iou: Array
    other: Indices
    other_iou: Array

    def kinds(self, least_iou: float) -> Indices:
        """Index into `ErrorKind` of each, shape (n,); a localisation error comes before one of the label."""
        duplicate, localisation = self.same_iou >= least_iou, self.same_iou >= BACKGROUND_IOU
        classification, both = self.other_iou >= least_iou, self.other_iou >= BACKGROUND_IOU
        order = ErrorKind.DUPLICATE, ErrorKind.LOCALISATION, ErrorKind.CLASSIFICATION, ErrorKind.BOTH
        places = [_KINDS.index(kind) for kind in order]
        background = _KINDS.index(ErrorKind.BACKGROUND)
        return np.select([duplicate, localisation, classification, both], places, default=background)


def error_shares(labelled: LabelledSet, by_label: Matched, images: Mask, least_iou: float = 0.5) -> ErrorShares:
    """The shares over some images, shape (I,), of matches label by label, by IoU in order of confidence."""
    results, annotations = labelled.results, labelled.annotations
    counts = by_label.counts & images[results.image]
    sought = by_label.sought & images[annotations.image]
    right = counts & (by_label.annotation >= 0)
    false = np.flatnonzero(counts & ~right)
    near = _nearest(labelled, false, sought)
    kinds = near.kinds(least_iou)
    taken = np.zeros(len(annotations), dtype=bool)
    taken[by_label.annotation[right]] = True
    mislabelled, misplaced = (kinds == _KINDS.index(kind) for kind in _KINDS[:2])
    covered = taken.copy()
    covered[near.other[mislabelled]] = True
    covered[near.same[misplaced]] = True
    missed = sought & ~covered
    state = _State(labelled, counts, right, results.label, sought)
    corrected = {kind: state.without(false[kinds == index]) for index, kind in enumerate(_KINDS)}
    corrected[ErrorKind.CLASSIFICATION] = state.corrected(false[mislabelled], near.other[mislabelled], taken)
    corrected[ErrorKind.LOCALISATION] = state.corrected(false[misplaced], near.same[misplaced], taken)
    corrected[ErrorKind.MISSED] = replace(state, sought=sought & ~missed)
    plain, numbers = state.mean_precision(), np.bincount(kinds, minlength=len(_KINDS)).tolist()
    numbers[_KINDS.index(ErrorKind.MISSED)] = int(missed.sum())
    gains = [100 * (corrected[kind].mean_precision() - plain) for kind in _KINDS]
    return ErrorShares(plain, tuple(map(ErrorShare, _KINDS, numbers, gains)))


def _nearest(labelled: LabelledSet, rows: Indices, sought: Mask) -> _Nearest:
    """Best annotations for some rows of the results (n,); −1 where nothing overlaps."""
    results, annotations, size = labelled.results, labelled.annotations, len(rows)
    best = {same: (np.full(size, NOBODY), np.zeros(size)) for same in (True, False)}
    columns = np.flatnonzero(sought)
    for first, second in image_pairs(results.image[rows], annotations.image[columns], len(labelled.images)):
        target = columns[second]
        value = overlap(results.boxes_px[rows[first]], annotations.boxes_px[target], annotations.crowd[target])
        equal = results.label[rows[first]] == annotations.label[target]
        for same, (where, how) in best.items():
            ours = np.flatnonzero((equal == same) & (value > 0))
            order = ours[np.argsort(value[ours], kind="stable")]
            where[first[order]], how[first[order]] = target[order], value[order]  # the last, largest one stays
    return _Nearest(*best[True], *best[False])


@dataclass(frozen=True, eq=False)
class _State:
    """Detections as they are, or with some errors corrected; columns of the results, and which annotations count."""

    labelled: LabelledSet
    counts: Mask
    right: Mask
    label: Indices
    sought: Mask

    def mean_precision(self) -> float:
        """Mean average precision over the labels that are there, by all points."""
        results, annotations, values = self.labelled.results, self.labelled.annotations, []
        for label in range(len(self.labelled.labels)):
            total = int((self.sought & (annotations.label == label)).sum())
            if not total:
                continue
            rows = np.flatnonzero(self.counts & (self.label == label))
            rows = rows[np.argsort(-results.confidence[rows], kind="stable")]
            right = np.cumsum(self.right[rows])
            recall = np.minimum(right / total, 1.0)
            values.append(Curve(recall, right / np.arange(1, len(rows) + 1), results.confidence[rows]).all_points())
        return float(np.mean(values)) if values else 0.0

    def without(self, rows: Indices) -> _State:
        """Leave some detections out, shape (n,)."""
        counts = self.counts.copy()
        counts[rows] = False
        return replace(self, counts=counts)

    def corrected(self, rows: Indices, annotations: Indices, taken: Mask) -> _State:
        """Make some detections right.

        Args:
            rows: The detections, shape (n,).
            annotations: The annotation of each, shape (n,). The most confident detection of one counts, if nothing else
                has detected it; the other rows are left out.
            taken: Which annotations have been detected, shape (T,).
        """
        free = ~taken[annotations]
        order = np.argsort(-self.labelled.results.confidence[rows[free]], kind="stable")
        rows_free, annotations_free = rows[free][order], annotations[free][order]
        _, first = np.unique(annotations_free, return_index=True)
        chosen = rows_free[first]
        right, counts, label = self.right.copy(), self.counts.copy(), self.label.copy()
        counts[rows] = False
        counts[chosen], right[chosen] = True, True
        label[chosen] = self.labelled.annotations.label[annotations_free[first]]
        return replace(self, counts=counts, right=right, label=label)
