"""The figures that a paper would print, for a group of images (Jessen & Mohr (2023), chapters 5 and 8)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.boxes import errors_between
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Matching, Rule, fits, image_pairs, overlap
from modsim3d.learn.bootstrap import Column, Resampling, ratio
from modsim3d.learn.box_errors.laws import ErrorMoments

# ---- Precision against recall ----

COCO_POINTS, FEW_POINTS = 101, 11


@dataclass(frozen=True, eq=False)
class Curve:
    """Recall, which does not fall, precision and the least confidence that gives both, shapes (m,)."""

    recall: Array
    precision: Array
    confidence: Array

    @property
    def interpolated(self) -> Array:
        """Largest precision at this recall or a larger one (eq. 5.45), shape (m,)."""
        return np.maximum.accumulate(self.precision[::-1])[::-1]

    def at_points(self, points: int) -> float:
        """Mean interpolated precision at evenly spaced levels of recall (eq. 5.43 with 11 points)."""
        place = np.searchsorted(self.recall, np.linspace(0, 1, points), side="left")
        return float(np.append(self.interpolated, 0.0)[place].mean())

    def all_points(self) -> float:
        """Area under the interpolated curve (eq. 5.44)."""
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.interpolated))

    def area(self) -> float:
        """Area under the curve itself, by trapezia from the first point on; level before it."""
        if not len(self.recall):
            return 0.0
        recall, precision = np.append(0.0, self.recall), np.append(self.precision[0], self.precision)
        return float(np.trapezoid(precision, recall))

    def summaries(self) -> tuple[float, float, float, float]:
        """Average precision by all points, by 11 and by COCO's 101, and the area under the curve itself."""
        return self.all_points(), self.at_points(FEW_POINTS), self.at_points(COCO_POINTS), self.area()


@dataclass(frozen=True, eq=False)
class Ranking:
    """Detections of one label, the most confident first."""

    image: Indices  # of each detection, shape (m,)
    right: Mask  # whether each matches an annotation, shape (m,)
    confidence: Array  # non-increasing, shape (m,)
    annotation_image: Indices  # image of each annotation that is to be detected, shape (T,)

    @classmethod
    def of(cls, labelled: LabelledSet, matched: Matching, label: int, images: Mask) -> Ranking:
        """Detections of a label in some images, shape (I,), matched label by label at any confidence."""
        results, annotations = labelled.results, labelled.annotations
        rows = np.flatnonzero(matched.counts & (results.label == label) & images[results.image])
        rows = rows[np.argsort(-results.confidence[rows], kind="stable")]
        sought = matched.sought & (annotations.label == label) & images[annotations.image]
        right = matched.annotation[rows] >= 0
        return cls(results.image[rows], right, results.confidence[rows], annotations.image[sought])

    def curve(self, weights: Array | None = None) -> Curve | None:
        """The curve under weights of images, shape (I,), all one if None; None if there is nothing to detect."""
        counts = np.ones(len(self.image)) if weights is None else weights[self.image]
        total = len(self.annotation_image) if weights is None else float(weights[self.annotation_image].sum())
        if total <= 0:
            return None
        right = np.cumsum(np.where(self.right, counts, 0.0))
        every = np.cumsum(counts)
        some = every > 0
        return Curve(right[some] / total, right[some] / every[some], self.confidence[some])


def average_precisions(ranking: Ranking, weights: Array) -> Array:
    """The summaries of the curve under each row of weights (rows, I), shape (rows, 4); NaN without annotations."""
    result = np.full((len(weights), 4), np.nan)
    for row, weight in enumerate(weights):
        curve = ranking.curve(None if row == 0 and np.all(weight == 1) else weight)
        if curve is not None:
            result[row] = curve.summaries()
    return result


CURVE_REPLICATES = 200  # average precision is computed again for each of at most so many replicates
_MIN_PROBABILITY = 1e-12


class Rates(NamedTuple):
    """Rates of one kind of detection, each of the same shape (eq. 5.1 to 5.20)."""

    precision: Column
    recall: Column
    f1: Column
    f_beta: Column
    false_negative_rate: Column
    false_discovery_rate: Column

    @classmethod
    def of(cls, right: Array, detected: Array, true: Array, beta: float) -> Rates:
        """Rates from numbers of right detections, of detections and of annotations, shapes (rows, ...)."""
        precision, recall = ratio(right, detected), ratio(right, true)
        f1, f_beta = (ratio((1 + w**2) * right, detected + w**2 * true) for w in (1, beta))  # eq. 5.9, 5.11 in counts
        number, whole = detected[0], true[0]
        return cls(
            Column(precision, "share", number),
            Column(recall, "share", whole),
            Column(f1, "fraction", whole),
            Column(f_beta, "fraction", whole),
            Column(1 - recall, "share", whole),
            Column(1 - precision, "share", number),
        )

    def averaged(self, weights: Array, count: float) -> Rates:
        """Means over labels that are there, weights of shape (rows, k), from so many annotations (eq. 5.22, 5.23)."""
        return Rates(*(_average(column, weights, count) for column in self))


class AveragePrecisions(NamedTuple):
    """Average precision in four forms; see `Curve.summaries`."""

    all_points: Column
    eleven_points: Column
    coco_points: Column
    area: Column


@dataclass(frozen=True, eq=False)
class Figures:
    """The figures of one condition or state, in so many images, which so many resampled runs or images hold."""

    name: str
    images: int
    units: int
    # Confusion matrix, detected labels in rows, true ones in columns, then background; the last, undefined entry is 0;
    # shape (k + 1, k + 1) (section 5.6.2).
    counts: Array
    any_label: Rates
    of_labels: Rates  # of each label, shape (k,)
    mean: Rates  # over labels
    weighted: Rates  # mean over labels, weighted by annotations
    confusion: Column  # probabilities, shape (k + 1, k) (eq. 5.25)
    false_labels: Column  # share of each label among false positives, shape (k,) (eq. 5.26)
    errors: ErrorMoments  # of the box errors in pixels (eq. 5.36 to 5.41)
    error_covariance: Column  # of the `CELLS`, in px², shape (10,)
    errors_of_labels: tuple[ErrorMoments, ...]
    average_precision: AveragePrecisions | None  # of each label, shape (k,); None without confidences, as the next two
    mean_average_precision: AveragePrecisions | None  # over labels that are there (eq. 5.46)
    confidence_entropy: Column | None  # cross-entropy of confidence, as the probability of being right
    label_entropy: Column | None  # cross-entropy of labels; None if no probabilities are given


@dataclass(frozen=True, eq=False)
class Matches:
    """A labelled set with its matches, and how its images are resampled."""

    labelled: LabelledSet
    matched: Matching  # with labels left aside, above the confidence threshold
    by_label: Matching | None  # label by label, at any confidence: for average precision. None without confidences
    resampling: Resampling
    beta: float = 2.0  # how many times more recall weighs than precision in F-beta
    # Factor by which persistent misses raise variances at least. Replicates cannot tell it for what happened once.
    inflation: float = 1.0

    def figures(self, name: str, images: Mask) -> Figures:
        """The figures of some images, shape (I,), called by a name."""
        counts = confusion_counts(self.labelled, self.matched, self.resampling, images)
        k = len(self.labelled.labels)
        right = np.einsum("bii->bi", counts)[:, :k]
        detected, true = counts[:, :k].sum(axis=2), counts[:, :, :k].sum(axis=1)
        of_labels = Rates.of(right, detected, true, self.beta)
        any_right = counts[:, :k, :k].sum(axis=(1, 2))
        false = counts[:, :k, k]
        total = false.sum(axis=1, keepdims=True)
        by_label = self._average_precision(images)
        found_in, label, errors = self._errors(images)
        moments = ErrorMoments.of(self.resampling, found_in, errors)
        return Figures(
            name=name,
            images=int(images.sum()),
            units=self.resampling.units(images),
            counts=counts[0],
            any_label=Rates.of(any_right, detected.sum(axis=1), true.sum(axis=1), self.beta),
            of_labels=of_labels,
            mean=of_labels.averaged(np.ones_like(true), true[0].sum()),
            weighted=of_labels.averaged(true, true[0].sum()),
            confusion=Column(
                ratio(counts[:, :, :k], true[:, None]), "share", np.tile(true[0], (k + 1, 1)), self.inflation
            ),
            false_labels=Column(ratio(false, total), "share", np.full(k, total[0, 0])),
            errors=moments,
            error_covariance=moments.covariance(),
            errors_of_labels=tuple(
                ErrorMoments.of(self.resampling, found_in[label == index], errors[label == index]) for index in range(k)
            ),
            average_precision=by_label,
            mean_average_precision=by_label
            and AveragePrecisions(*(_average(form, np.ones_like(form.values), form.counts.sum()) for form in by_label)),
            confidence_entropy=self._confidence_entropy(images),
            label_entropy=self._label_entropy(images),
        )

    def _errors(self, images: Mask) -> tuple[Indices, Indices, Array]:
        """Image (m,), true label (m,) and box error (m, 4) of each match."""
        results, annotations = self.labelled.results, self.labelled.annotations
        detection, annotation = self.matched.pairs
        inside = images[results.image[detection]]
        detection, annotation = detection[inside], annotation[inside]
        errors = errors_between(results.boxes_px[detection], annotations.boxes_px[annotation])
        return results.image[detection], annotations.label[annotation], errors

    def _average_precision(self, images: Mask) -> AveragePrecisions | None:
        if self.by_label is None:
            return None
        weights = self.resampling.weights[: 1 + CURVE_REPLICATES]
        labels = range(len(self.labelled.labels))
        rankings = [Ranking.of(self.labelled, self.by_label, label, images) for label in labels]
        values = np.stack([average_precisions(ranking, weights) for ranking in rankings], axis=1)  # (rows, k, 4)
        number = np.array([float(len(ranking.annotation_image)) for ranking in rankings])
        return AveragePrecisions(*(Column(values[:, :, form], "fraction", number) for form in range(4)))

    def _confidence_entropy(self, images: Mask) -> Column | None:
        if not self.labelled.scored:
            return None
        results = self.labelled.results
        rows = np.flatnonzero(self.matched.counts & images[results.image])
        right = self.matched.annotation[rows] >= 0
        chance = np.where(right, results.confidence[rows], 1 - results.confidence[rows])
        return self._entropy(results.image[rows], chance)

    def _label_entropy(self, images: Mask) -> Column | None:
        results = self.labelled.results
        if results.probabilities is None:
            return None
        rows, annotation = self.matched.pairs
        given = images[results.image[rows]] & np.isfinite(results.probabilities[rows, 0])
        rows, annotation = rows[given], annotation[given]
        chance = results.probabilities[rows, self.labelled.annotations.label[annotation]]
        return self._entropy(results.image[rows], chance)

    def _entropy(self, image: Indices, chance: Array) -> Column:
        """Mean of −log p, given images (n,) and probabilities p (n,)."""
        loss = -np.log(np.clip(chance, _MIN_PROBABILITY, 1))
        sums = self.resampling.sums(image, np.column_stack([np.ones(len(loss)), loss]))
        return Column(ratio(sums[:, 1], sums[:, 0]), "positive", np.array(float(len(loss))))


def confusion_counts(labelled: LabelledSet, matched: Matching, resampling: Resampling, images: Mask) -> Array:
    """Confusion matrices of some images (I,), shape (rows, k + 1, k + 1)."""
    results, annotations, size = labelled.results, labelled.annotations, len(labelled.labels) + 1
    sought = np.flatnonzero(matched.sought & images[annotations.image])
    detection = matched.detection[sought]
    detected_label = np.where(detection >= 0, results.label[detection] if len(results) else 0, size - 1)
    false = matched.false[images[results.image[matched.false]]]
    image = np.concatenate([annotations.image[sought], results.image[false]])
    cell = np.concatenate([detected_label * size + annotations.label[sought], results.label[false] * size + size - 1])
    return resampling.counts(image, cell, (size, size))


def _average(column: Column, weights: Array, count: float) -> Column:
    """Mean over labels that are there, under weights (rows, k), that rests on so many annotations."""
    finite = np.isfinite(column.values)
    weights = np.where(finite, weights, 0.0)
    filled = np.where(finite, column.values, 0.0)
    return Column(ratio((filled * weights).sum(axis=1), weights.sum(axis=1)), "fraction", np.array(count))


# ---- Losses of average precision ----


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
class _NearestMatches:
    """Best annotation of the same and of another label for n detections, −1 for none, and whether it `_FITS`, is
    `_NEAR` by the rule or `_FAR`, shapes (n,)."""

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


def error_shares(labelled: LabelledSet, by_label: Matching, images: Mask, rule: Rule) -> ErrorShares:
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


def _nearest(labelled: LabelledSet, rows: Indices, sought: Mask, rule: Rule) -> _NearestMatches:
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
            pairs = np.flatnonzero((equal == same) & (place > _FAR))
            order = pairs[np.lexsort((quality[pairs], place[pairs]))]
            where[first[order]], how[first[order]] = target[order], place[order]  # the last, best one stays
    return _NearestMatches(*best[True], *best[False])


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
        """Make some detections (n,) right, of annotations (n,), beside those that are detected (T,): the most confident
        of each annotation that nothing has detected; others are left out."""
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
