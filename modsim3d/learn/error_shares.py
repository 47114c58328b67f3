"""Losses of average precision, one kind of error at a time (after Bolya et al. (2020), "TIDE").
A false detection is classed by the annotation that it fits best: `classification` (well placed, another label),
`localisation` (right label, badly placed), `both`, `duplicate` (of what a more confident one has detected) or
`background`. An annotation that no detection comes near is `missed`. The gain of a kind is how much mean average
precision would rise if errors of that kind alone were corrected.
Well placed is what the matching rule lets match. By provenance every detection of a vessel is well placed, wherever its
box is; a second box of a vessel counts as `background`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from modsim3d.core.arrays import NOBODY, Indices, Mask
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matched, Rule, fits, image_pairs, overlap
from modsim3d.learn.figures import Curve


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
    """Number of errors of a kind, and the hundredths of mean average precision that they cost."""

    kind: ErrorKind
    count: int
    gain_points: float


@dataclass(frozen=True)
class ErrorShares:
    """Losses of mean average precision, over labels and by all points: a share for each kind of error."""

    average_precision: float
    shares: tuple[ErrorShare, ...]


_FAR, _NEAR, _FITS = range(3)


@dataclass(frozen=True, eq=False)
class _Nearest:
    """The best annotation of the same and of another label for each of n detections, −1 for none, shapes (n,). Beside
    each stands whether it fits by the rule, is only near or is far: `_FITS`, `_NEAR` or `_FAR`."""

    same: Indices
    same_place: Indices
    other: Indices
    other_place: Indices

    def kinds(self) -> Indices:
        """Index into `ErrorKind` of each, shape (n,); a localisation error comes before one of the label."""
        duplicate, localisation = self.same_place == _FITS, self.same_place >= _NEAR
        classification, both = self.other_place == _FITS, self.other_place >= _NEAR
        order = ErrorKind.DUPLICATE, ErrorKind.LOCALISATION, ErrorKind.CLASSIFICATION, ErrorKind.BOTH
        places = [_KINDS.index(kind) for kind in order]
        background = _KINDS.index(ErrorKind.BACKGROUND)
        return np.select([duplicate, localisation, classification, both], places, default=background)


def error_shares(labelled: LabelledSet, by_label: Matched, images: Mask, rule: Rule) -> ErrorShares:
    """The shares over some images, shape (I,), of matches label by label by a rule."""
    results, annotations = labelled.results, labelled.annotations
    counts = by_label.counts & images[results.image]
    sought = by_label.sought & images[annotations.image]
    right = counts & (by_label.annotation >= 0)
    false = np.flatnonzero(counts & ~right)
    near = _nearest(labelled, false, sought, replace(rule, by_label=False))
    kinds = near.kinds()
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


def _nearest(labelled: LabelledSet, rows: Indices, sought: Mask, rule: Rule) -> _Nearest:
    """Best annotations for some rows of the results (n,)."""
    results, annotations, size = labelled.results, labelled.annotations, len(rows)
    best = {same: (np.full(size, NOBODY), np.full(size, _FAR)) for same in (True, False)}
    columns = np.flatnonzero(sought)
    for first, second in image_pairs(results.image[rows], annotations.image[columns], len(labelled.images)):
        detection, target = rows[first], columns[second]
        good, quality = fits(labelled, detection, target, rule)
        place = np.where(good, _FITS, np.where(_is_near(labelled, detection, target, rule), _NEAR, _FAR))
        equal = results.label[detection] == annotations.label[target]
        for same, (where, how) in best.items():
            ours = np.flatnonzero((equal == same) & (place > _FAR))
            order = ours[np.lexsort((quality[ours], place[ours]))]
            where[first[order]], how[first[order]] = target[order], place[order]  # the last, best one stays
    return _Nearest(*best[True], *best[False])


def _is_near(labelled: LabelledSet, detection: Indices, annotation: Indices, rule: Rule) -> Mask:
    """Whether boxes overlap so much that one may be meant for the other, pair by pair, shape (n,)."""
    if rule.method == "provenance":
        return np.zeros(len(detection), dtype=bool)
    annotations = labelled.annotations
    a_px, b_px = labelled.results.boxes_px[detection], annotations.boxes_px[annotation]
    return overlap(a_px, b_px, annotations.crowd[annotation]) >= BACKGROUND_IOU


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
        """Make some detections (n,) right, of an annotation each (n,), given which annotations have been detected (T,).
        The most confident detection of one counts, if nothing else has detected it; the others are left out."""
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
