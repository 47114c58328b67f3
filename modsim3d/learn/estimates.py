"""The numbers of a detector file, estimated: every one with its replicates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import centres, sizes
from modsim3d.learn.clipped_scores import clipped_sums, fit_clipped
from modsim3d.learn.dropout_fit import fit_misses
from modsim3d.learn.figures import error_columns
from modsim3d.learn.form import FALSE_NEEDED, QUANTILES, Form, error_gaps, error_products, miss_products
from modsim3d.learn.observed import Observed
from modsim3d.learn.persistence_fit import correlation_time, frame_interval_s, relative_error, steps_between
from modsim3d.learn.resampling import Column, Resampling, spread

Columns = dict[str, Column]
"""By path, such as `states.clear.confusion`."""
_QUANTILE_REPLICATES = 200
_ALMOST_ANY = 0.99


def estimate(observed: Observed, form: Form, resampling: Resampling) -> Columns:
    """All numbers of a detector file of a form.

    Args:
        observed: The data.
        form: The models.
        resampling: Weights of the images.
    """
    columns: Columns = {}
    columns |= _persistence(observed, form, resampling)
    columns |= _classes(observed, form, resampling, least_inflation(observed, columns))
    columns |= _box_errors(observed, form, resampling, _kept(observed, columns, "box_s"))
    columns |= _clutter(observed, form, resampling)
    columns |= _confidence(observed, form, resampling)
    return columns


def _share(part: Array, whole: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(whole > 0, part / whole, np.nan)


def _kept(observed: Observed, columns: Columns, name: str) -> float:
    """Share of the noise that is kept from one frame to the next."""
    column = columns.get(f"persistence.{name}")
    if column is None or column.estimate <= 0:
        return 0.0
    return float(np.exp(-frame_interval_s(observed.labelled) / column.estimate))


def least_inflation(observed: Observed, columns: Columns) -> float:
    """Variance of the number of frames in which a thing is missed or confused, over that of independent frames."""
    kept = _kept(observed, columns, "class_s")
    return (1 + kept) / (1 - kept)


def _classes(observed: Observed, form: Form, resampling: Resampling, inflation: float) -> Columns:
    """Confusion matrices, and what the odds of a miss follow."""
    k, states = len(form.labels), len(form.states)
    cell = (observed.state * (k + 1) + observed.seen_as) * k + observed.label
    counts = resampling.counts(observed.image, cell, (states, k + 1, k))
    whole = counts.sum(axis=2, keepdims=True)
    rates = _share(counts, whole)
    columns: Columns = {}
    fit = fit_misses(observed, form.effects, resampling) if form.effects else None
    if fit is not None:
        detected = np.maximum(1 - rates[:, :, k], 1e-12)
        held = np.where(np.isfinite(fit.rates), fit.rates, rates[:, :, k])
        rates[:, :, :k] *= ((1 - held) / detected)[:, :, None]
        rates[:, :, k] = held
        for place, effect in enumerate(form.effects):
            key = "per_doubling" if effect.doublings else "per_unit"
            path = f"dropout.{effect.attribute}.{key}"
            slopes = _widened(fit.slopes[:, place], fit.errors[place] * np.sqrt(inflation))
            columns[path] = Column(slopes, "mean", np.array(float(len(observed.rows))))
    everywhere = _share(counts.sum(axis=1), whole.sum(axis=1))
    for index, name in enumerate(form.states):
        table = np.where(np.isfinite(rates[:, index]), rates[:, index], everywhere)
        columns[f"states.{name}.confusion"] = Column(table, "share", np.tile(whole[0, index], (k + 1, 1)), inflation)
    return columns


def _widened(values: Array, least: Array) -> Array:
    """Replicates whose spread is at least a standard error from theory, noise that persists taken into account.

    Of few runs of frames, or of few things that decide a number, replicates alone spread too little on average.
    """
    if len(values) == 1:
        return values
    found = spread(values[1:])
    usable = np.isfinite(found) & (found > 0) & np.isfinite(least)
    factor = np.where(usable, np.maximum(least / np.where(usable, found, 1.0), 1.0), 1.0)
    widened: Array = values[0] + factor * (values - values[0])
    return widened


def _normal_errors(columns: Columns, prefix: str, kept: float) -> Columns:
    """Moments of normal errors, with replicates that spread at least as theory has it.

    Args:
        columns: Mean, standard deviation and correlation.
        prefix: Of their paths.
        kept: Correlation of one error with that of the frame before.
    """
    mean, std, correlation = (columns[f"{prefix}_{name}"] for name in ("mean", "std", "correlation"))
    root = np.sqrt(np.maximum(mean.counts[0], 1.0))
    of_sums, of_squares = np.sqrt((1 + kept) / (1 - kept)) / root, np.sqrt((1 + kept**2) / (1 - kept**2)) / root
    least = (
        std.estimate * of_sums,
        std.estimate * of_squares / np.sqrt(2),
        (1 - correlation.estimate**2) * of_squares,
    )
    every = zip(("mean", "std", "correlation"), (mean, std, correlation), least, strict=True)
    return {f"{prefix}_{name}": replace(column, values=_widened(column.values, error)) for name, column, error in every}


def _box_errors(observed: Observed, form: Form, resampling: Resampling, kept: float) -> Columns:
    pairs, sizes = observed.pairs(), observed.labelled.images.sizes_px
    columns: Columns = {}
    for index, name in enumerate(form.states):
        unit = form.units[name]
        use = pairs.used(sizes, unit, index)
        errors = pairs.error_px[use] / (pairs.sides_px[use] if unit.endswith("relative") else 1.0)
        moments = error_columns(resampling, pairs.image[use], errors)
        prefix = f"states.{name}.box_error"
        columns |= _normal_errors({f"{prefix}_{key.split()[1]}": moments[key] for key in moments}, prefix, kept)
    return columns


def _persistence(observed: Observed, form: Form, resampling: Resampling) -> Columns:
    columns: Columns = {}
    if form.class_persists:
        products, expected, later = miss_products(observed, form.effects)
        gaps = steps_between(observed.labelled, observed.rows).apart_s
        image = observed.image[later]
        columns["persistence.class_s"] = correlation_column(resampling, image, products, expected, gaps)
    if form.box_persists:
        products, expected, later = error_products(observed, form.units)
        gaps, image = error_gaps(observed, form.units), observed.pairs().image[later]
        columns["persistence.box_s"] = correlation_column(resampling, image, products, expected, gaps)
    return columns


def correlation_column(
    resampling: Resampling, image: Indices, products: Array, expected: Array, gaps_s: Array
) -> Column:
    """A correlation time; its replicates spread at least as pairs say, for runs of frames may be few."""
    times = correlation_time(resampling, image, products, expected, gaps_s)
    if times[0] > 0:
        least = np.array(relative_error(products, expected, gaps_s, float(times[0])))
        times = np.exp(_widened(np.log(np.maximum(times, 1e-12)), least))
    return Column(times, "positive", np.array(float(len(products))))


def _clutter(observed: Observed, form: Form, resampling: Resampling) -> Columns:
    """How many false detections, with which labels, how large and where."""
    found, states, k = observed.labelled.results, len(form.states), len(form.labels)
    image = found.image[observed.false]
    state = observed.image_state[image]
    labels = resampling.counts(image, state * k + found.label[observed.false], (states, k))
    false = labels.sum(axis=2)
    seen = ~observed.missed
    true = resampling.counts(observed.image[seen], observed.state[seen], (states,))
    chosen = np.flatnonzero(observed.image_state >= 0)
    images = resampling.counts(chosen, observed.image_state[chosen], (states,))
    columns: Columns = {}
    for index, name in enumerate(form.states):
        number = false[:, index]
        share = np.nan_to_num(_share(number, number + true[:, index]))
        columns[f"states.{name}.false_discovery_rate"] = Column(share, "share", number[0] + true[0, index])
        rate = np.nan_to_num(_share(number, images[:, index]))
        columns[f"states.{name}.false_positives_per_image"] = Column(rate, "rate", images[0, index])
        table = _share(labels[:, index], number[:, None])
        overall = _share(labels.sum(axis=1), false.sum(axis=1, keepdims=True))
        table = np.where(np.isfinite(table), table, np.where(np.isfinite(overall), overall, 1 / k))
        columns[f"states.{name}.false_positive_labels"] = Column(table, "share", np.full(k, number[0]))
    boxes = found.boxes_px[observed.false]
    if form.sizes:
        columns |= _sizes(image, boxes, observed.labelled.images.sizes_px[image], resampling)
    if form.grid:
        rows, across = form.grid
        centre = centres(boxes) / observed.labelled.images.sizes_px[image]
        place = np.clip(np.floor(centre * [across, rows]), 0, [across - 1, rows - 1]).astype(np.int64)
        map_ = resampling.counts(image, place[:, 1] * across + place[:, 0], form.grid)
        total = map_.sum(axis=(1, 2), keepdims=True)
        columns["false_positives.density"] = Column(_share(map_, total), "share", np.full(form.grid, total[0, 0, 0]))
    return columns


def _sizes(image: Indices, boxes_px: Array, sizes_px: Array, resampling: Resampling) -> Columns:
    """One shape, of a size whose logarithm is normal.

    From boxes whose centres are farther from the image's edge than half of almost any box: the edge cuts the others.
    """
    half = np.quantile(sizes(boxes_px), _ALMOST_ANY, axis=0) / 2
    centre = centres(boxes_px)
    inner = np.all((centre > half) & ((centre < sizes_px - half) | np.isnan(sizes_px)), axis=1)
    if inner.sum() >= FALSE_NEEDED:
        image, boxes_px = image[inner], boxes_px[inner]
    sides = np.log(np.maximum(sizes(boxes_px), 1e-6))
    scale = sides.mean(axis=1)
    values = np.column_stack([np.ones(len(sides)), sides, scale, scale**2])
    sums = resampling.sums(image, values)
    number = sums[:, 0]
    mean = sums[:, 1:3] / number[:, None]
    variance = (sums[:, 4] - sums[:, 3] ** 2 / number) / np.maximum(number - 1, 1)
    count = float(len(sides))
    px, std, root = np.exp(mean), np.sqrt(np.maximum(variance, 0)), np.sqrt(count)
    return {
        "false_positives.size.px": Column(_widened(px, px[0] * std[0] / root), "positive", np.full(2, count)),
        "false_positives.size.log_std": Column(_widened(std, std[0] / root / np.sqrt(2)), "positive", np.array(count)),
    }


def _confidence(observed: Observed, form: Form, resampling: Resampling) -> Columns:
    columns: Columns = {}
    for path, kind, image, values in confidences(observed, form):
        count = float(len(values))
        if kind == "normal":
            sums = resampling.sums(image, clipped_sums(values, form.threshold, 1.0))
            mean, std = fit_clipped(sums, form.threshold, 1.0)
            root = np.sqrt(max(count, 1.0))
            columns[f"{path}.mean"] = Column(_widened(mean, std[0] / root), "mean", np.array(count))
            columns[f"{path}.std"] = Column(_widened(std, std[0] / root / np.sqrt(2)), "positive", np.array(count))
        elif kind == "quantiles":
            columns[f"{path}.quantiles"] = Column(
                _quantiles(image, values, resampling), "mean", np.full(QUANTILES, count)
            )
    return columns


def confidences(observed: Observed, form: Form) -> Iterator[tuple[str, str, Indices, Array]]:
    """Path, form, image and values of the confidence of each state and kind; of all states where shared."""
    found, pairs = observed.labelled.results, observed.pairs()
    false_image = found.image[observed.false]
    kinds = (
        ("true", pairs.image, pairs.state, pairs.confidence),
        ("false", false_image, observed.image_state[false_image], found.confidence[observed.false]),
    )
    for place, (kind, image, state, values) in enumerate(kinds):
        for index, name in enumerate(form.states):
            chosen = form.scores[name][place]
            ours = np.ones(len(image), dtype=bool) if chosen == "shared" else state == index
            chosen = "normal" if chosen == "shared" else chosen
            yield f"states.{name}.confidence.{kind}", chosen, image[ours], values[ours]


def _quantiles(image: Indices, values: Array, resampling: Resampling) -> Array:
    """Evenly spaced quantiles of weighted numbers, shape (rows, QUANTILES)."""
    order = np.argsort(values, kind="stable")
    ordered, image = values[order], image[order]
    rows = resampling.weights[: 1 + _QUANTILE_REPLICATES]
    result = np.empty((len(rows), QUANTILES))
    levels = np.linspace(0, 1, QUANTILES)
    for row, weights in enumerate(rows):
        mass = np.cumsum(weights[image])
        kept = weights[image] > 0
        if not kept.any():
            result[row] = np.nan
            continue
        middle = (mass - weights[image] / 2)[kept] / mass[-1]
        result[row] = np.interp(levels, middle, ordered[kept])
    return result
