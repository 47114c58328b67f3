"""The figures that a paper would print, for a group of images (Jessen & Mohr (2023), chapters 5 and 8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.boxes import errors_between
from modsim3d.learn.average_precision import NUMBERS, Ranking, average_precisions
from modsim3d.learn.labelled import LabelledSet
from modsim3d.learn.matching import Matched
from modsim3d.learn.resampling import Column, Resampling

PAIRS = tuple((i, j) for i in range(4) for j in range(i + 1, 4))
CELLS = tuple((i, j) for i in range(4) for j in range(i, 4))
RATES = ("precision", "recall", "F1", "F-beta", "FNR", "FDR")
CURVE_REPLICATES = 200
"""Average precision is worked out anew for each of at most so many replicates."""


@dataclass(frozen=True, eq=False)
class Figures:
    """Those of one condition or state.

    Attributes:
        name: Of the group.
        images: How many.
        units: Of what was drawn to resample.
        counts: Confusion matrix, rows what was detected, columns what was there, both labels then background; its last
            entry is undefined and 0; shape (k + 1, k + 1) (section 5.6.2).
        columns: `RATES` of each label (eq. 5.1 to 5.20), shape (k,) each; `mean ...` and `weighted ...` over labels
            (eq. 5.22, 5.23); `any ...` with labels left aside; `confusion`, (k + 1, k), and `false labels`, (k,)
            (eq. 5.25, 5.26); `error mean`, `error std`, `error correlation` and, of `CELLS`, `error covariance`
            (eq. 5.36 to 5.41), and `error mean of labels` and `error std of labels`, (k, 4); `average_precision`
            numbers of each label and their means (eq. 5.46); cross-entropies.
    """

    name: str
    images: int
    units: int
    counts: Array
    columns: Mapping[str, Column]

    def covariance(self) -> Array:
        """Of the box errors in pixels, shape (4, 4) (eq. 5.41)."""
        return covariance(self.columns["error std"].estimate, self.columns["error correlation"].estimate)


def covariance(std: Array, correlation: Array) -> Array:
    """From standard deviations of shape (4,) and correlations of the `PAIRS`."""
    matrix = np.eye(4)
    for (i, j), value in zip(PAIRS, correlation, strict=True):
        matrix[i, j] = matrix[j, i] = value
    result: Array = np.outer(std, std) * matrix
    return result


def moments(resampling: Resampling, image: np.ndarray, values: Array) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and correlation of rows of four, with n − 1; shapes (rows, 4), (rows, 4), (rows, 6)."""
    centre = values.mean(axis=0) if len(values) else np.zeros(4)
    moved = values - centre  # squares of small numbers keep their digits
    products = moved[:, :, None] * moved[:, None, :]
    sums = resampling.sums(image, np.column_stack([np.ones(len(values)), moved, products.reshape(-1, 16)]))
    number = sums[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = sums[:, 1:5] / number[:, None]
        second = sums[:, 5:].reshape(-1, 4, 4) - number[:, None, None] * mean[:, :, None] * mean[:, None, :]
        second = second / (number - 1)[:, None, None]
        std = np.sqrt(np.maximum(np.einsum("bii->bi", second), 0))
        correlation = np.stack([second[:, i, j] / (std[:, i] * std[:, j]) for i, j in PAIRS], axis=1)
    few = number < 2
    std[few], correlation[few] = np.nan, np.nan
    return mean + centre, std, np.where(np.isfinite(correlation), correlation, 0.0)


def error_columns(resampling: Resampling, image: np.ndarray, values: Array) -> dict[str, Column]:
    """Mean, standard deviation and correlation of box errors as columns."""
    mean, std, correlation = moments(resampling, image, values)
    number = float(len(values))
    return {
        "error mean": Column(mean, "mean", np.full(4, number)),
        "error std": Column(std, "positive", np.full(4, number)),
        "error correlation": Column(correlation, "correlation", np.full(6, number)),
    }


def confusion_counts(labelled: LabelledSet, matched: Matched, resampling: Resampling, images: Mask) -> Array:
    """Confusion matrices, shape (rows, k + 1, k + 1)."""
    found, truth, size = labelled.results, labelled.annotations, len(labelled.labels) + 1
    sought = np.flatnonzero(matched.sought & images[truth.image])
    detection = matched.detection[sought]
    seen_as = np.where(detection >= 0, found.label[detection] if len(found) else 0, size - 1)
    false = matched.false[images[found.image[matched.false]]]
    image = np.concatenate([truth.image[sought], found.image[false]])
    cell = np.concatenate([seen_as * size + truth.label[sought], found.label[false] * size + size - 1])
    return resampling.counts(image, cell, (size, size))


def _ratio(part: Array, whole: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(whole > 0, part / whole, np.nan)


def rates(right: Array, detected: Array, true: Array, beta: float) -> dict[str, Column]:
    """`RATES` from numbers that are right, that were detected, and that there are; shapes (rows, ...)."""
    precision, recall = _ratio(right, detected), _ratio(right, true)

    def f(weight: float) -> Array:
        return _ratio((1 + weight**2) * right, detected + weight**2 * true)  # eq. 5.9, 5.11 in counts

    number, whole = detected[0], true[0]
    return {
        "precision": Column(precision, "share", number),
        "recall": Column(recall, "share", whole),
        "F1": Column(f(1), "fraction", whole),
        "F-beta": Column(f(beta), "fraction", whole),
        "FNR": Column(1 - recall, "share", whole),
        "FDR": Column(1 - precision, "share", number),
    }


def figures(
    name: str,
    labelled: LabelledSet,
    matched: Matched,
    by_label: Matched,
    resampling: Resampling,
    images: Mask,
    beta: float = 2.0,
    inflation: float = 1.0,
) -> Figures:
    """The figures of some images.

    Args:
        name: What to call them.
        labelled: All images.
        matched: Labels left aside, above the confidence threshold.
        by_label: Label by label, at any confidence: for average precision.
        resampling: Weights of all images.
        images: Which, shape (I,).
        beta: How many times more recall weighs than precision in F-beta.
        inflation: By how much misses that persist raise variances, at least: of what happened once, replicates
            cannot tell.
    """
    counts = confusion_counts(labelled, matched, resampling, images)
    k = len(labelled.labels)
    right = np.einsum("bii->bi", counts)[:, :k]
    detected, true = counts[:, :k].sum(axis=2), counts[:, :, :k].sum(axis=1)
    columns = rates(right, detected, true, beta)
    columns |= _means(columns, true)
    matched_any = counts[:, :k, :k].sum(axis=(1, 2))
    every = rates(matched_any, detected.sum(axis=1), true.sum(axis=1), beta)
    columns |= {f"any {key}": column for key, column in every.items()}
    columns["confusion"] = Column(
        _ratio(counts[:, :, :k], true[:, None]), "share", np.tile(true[0], (k + 1, 1)), inflation
    )
    clutter = counts[:, :k, k]
    total = clutter.sum(axis=1, keepdims=True)
    columns["false labels"] = Column(_ratio(clutter, total), "share", np.full(k, total[0, 0]))
    found, truth = matched.pairs
    ours = images[labelled.results.image[found]]
    found, truth = found[ours], truth[ours]
    error = errors_between(labelled.results.boxes_px[found], labelled.annotations.boxes_px[truth])
    columns |= error_columns(resampling, labelled.results.image[found], error)
    columns["error covariance"] = _covariance_column(columns)
    columns |= _label_errors(resampling, labelled.results.image[found], labelled.annotations.label[truth], error, k)
    columns |= _precision_columns(labelled, by_label, resampling, images)
    columns |= _entropies(labelled, matched, resampling, images)
    return Figures(name, int(images.sum()), resampling.units(images), counts[0], columns)


def _covariance_column(columns: Mapping[str, Column]) -> Column:
    std, correlation = columns["error std"].values, columns["error correlation"].values
    of_pair = [correlation[:, PAIRS.index(cell)] if cell in PAIRS else 1.0 for cell in CELLS]
    values = [std[:, i] * std[:, j] * of for (i, j), of in zip(CELLS, of_pair, strict=True)]
    return Column(np.stack(values, axis=1), "mean", np.repeat(columns["error mean"].counts[:1], len(CELLS)))


def _label_errors(
    resampling: Resampling, image: np.ndarray, label: np.ndarray, error: Array, labels: int
) -> dict[str, Column]:
    """Mean and standard deviation of the errors at boxes of each true label."""
    of_label = [error_columns(resampling, image[label == k], error[label == k]) for k in range(labels)]
    return {
        f"{name} of labels": Column(
            np.stack([columns[name].values for columns in of_label], axis=1),
            of_label[0][name].kind,
            np.stack([columns[name].counts for columns in of_label]),
        )
        for name in ("error mean", "error std")
    }


def _means(columns: Mapping[str, Column], true: Array) -> dict[str, Column]:
    """Arithmetic and weighted means over the labels that are there (eq. 5.22, 5.23)."""
    result = {}
    for key in RATES:
        values = columns[key].values
        there = np.isfinite(values)
        filled = np.where(there, values, 0.0)
        whole = np.array(true[0].sum())
        result[f"mean {key}"] = Column(_ratio(filled.sum(axis=1), there.sum(axis=1)), "fraction", whole)
        weight = np.where(there, true, 0.0)
        result[f"weighted {key}"] = Column(_ratio((filled * weight).sum(axis=1), weight.sum(axis=1)), "fraction", whole)
    return result


def _precision_columns(
    labelled: LabelledSet, by_label: Matched, resampling: Resampling, images: Mask
) -> dict[str, Column]:
    weights = resampling.weights[: 1 + CURVE_REPLICATES]
    rankings = [Ranking.of(labelled, by_label, label, images) for label in range(len(labelled.labels))]
    values = np.stack([average_precisions(ranking, weights) for ranking in rankings], axis=1)  # (rows, k, 4)
    number = np.array([float(len(ranking.truth_image)) for ranking in rankings])
    result = {}
    for place, name in enumerate(NUMBERS):
        column = values[:, :, place]
        there = np.isfinite(column)
        mean = _ratio(np.where(there, column, 0).sum(axis=1), there.sum(axis=1))
        result[name] = Column(column, "fraction", number)
        result[f"mean {name}"] = Column(mean, "fraction", np.array(number.sum()))
    return result


_LEAST_PROBABILITY = 1e-12


def _entropies(labelled: LabelledSet, matched: Matched, resampling: Resampling, images: Mask) -> dict[str, Column]:
    """Mean cross-entropy: of labels where probabilities are given, and of confidence as that of being right."""
    found = labelled.results
    result = {}
    rows = np.flatnonzero(matched.counts & images[found.image])
    right = matched.annotation[rows] >= 0
    sure = np.clip(np.where(right, found.confidence[rows], 1 - found.confidence[rows]), _LEAST_PROBABILITY, 1)
    result["confidence cross-entropy"] = _mean_column(resampling, found.image[rows], -np.log(sure))
    if found.probabilities is not None:
        rows, truth = matched.pairs
        given = images[found.image[rows]] & np.isfinite(found.probabilities[rows, 0])
        rows, truth = rows[given], truth[given]
        chance = found.probabilities[rows, labelled.annotations.label[truth]]
        loss = -np.log(np.clip(chance, _LEAST_PROBABILITY, 1))
        result["label cross-entropy"] = _mean_column(resampling, found.image[rows], loss)
    return result


def _mean_column(resampling: Resampling, image: np.ndarray, values: Array) -> Column:
    sums = resampling.sums(image, np.column_stack([np.ones(len(values)), values]))
    return Column(_ratio(sums[:, 1], sums[:, 0]), "positive", np.array(float(len(values))))
