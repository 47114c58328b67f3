"""What a frame and a track look like in a detector's output, given the truth: the numbers that a classifier is shown.

A row is an image, or a vessel over a whole film with all that the detector made of it. What does not exist in a row,
such as the mean confidence of no detection, is NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.stand_in.sighted import Sighted, pairs_of_images
from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import areas, centres, sizes

MIN_IMAGES = 8
"""A vessel that is annotated in fewer images has no track to speak of."""
CLEAR, HIDDEN = 0.9, 0.5
"""Least visible fraction of a vessel in clear view, and the fraction below which one counts as hidden."""
SMALL_PX = 40
"""Width below which a vessel counts as small."""
SIDES = ("x", "y", "width", "height")
Groups = Mapping[str, Mapping[str, Array | Indices]]
"""What a feature is about → its name → its value in each row."""


@dataclass(frozen=True, eq=False)
class Table:
    """Features of frames or of tracks.

    Attributes:
        names: Of the columns.
        groups: What each column is about: the scene, misses, box errors, confidence, false positives.
        values: Shape (n, k).
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    values: Array

    @classmethod
    def of(cls, content: Groups) -> Table:
        """A table of columns that are given by group and name."""
        named = [(group, name, column) for group, columns in content.items() for name, column in columns.items()]
        groups, names, columns = zip(*named, strict=True)
        return cls(names, groups, np.stack(columns, axis=1).astype(np.float64))


def frame_features(film: Sighted) -> Table:
    """A row for each image of a film."""
    images = film.image
    count = len(film.labelled.images)

    def mean(values: Array | Mask, of: Indices = images) -> Array:
        return _means(values, of, count)

    def share(chosen: Mask) -> Array:
        return _means(np.where(chosen, film.hit, np.nan), images, count)

    small, hidden, clear = _kinds(film)
    change = _since(film, film.error)
    was_hit = np.where(film.previous >= 0, film.hit[film.previous], np.nan)
    results, false = film.labelled.results, film.false_image
    alone = ~film.second
    height_px = film.labelled.images.sizes_px[false, 1]
    errors = {f"mean error of {side}": mean(film.error[:, k]) for k, side in enumerate(SIDES)}
    errors |= {f"mean size of the error of {side}": mean(np.abs(film.error[:, k])) for k, side in enumerate(SIDES)}
    errors |= {f"change of the error of {side}": mean(np.abs(change[:, k])) for k, side in enumerate(SIDES)}
    return Table.of(
        {
            "scene": {
                "vessels": np.bincount(images, minlength=count),
                "mean visible fraction": mean(film.visible),
                "mean width": mean(sizes(film.boxes_px)[:, 0]),
            },
            "misses": {
                "share of vessels detected": mean(film.hit),
                "share detected in clear view": share(clear),
                "share detected of hidden ones": share(hidden),
                "share detected of small ones": share(small),
                "share newly missed": mean(np.where(was_hit == 1, ~film.hit, np.nan)),
                "share newly detected": mean(np.where(was_hit == 0, film.hit, np.nan)),
            },
            "box errors": errors
            | {"mean IoU": mean(film.overlap), "least IoU": _extremes(film.overlap, images, count, np.fmin)},
            "confidence": {
                "mean confidence": mean(film.confidence),
                "least confidence": _extremes(film.confidence, images, count, np.fmin),
                "greatest confidence": _extremes(film.confidence, images, count, np.fmax),
                "change of confidence": mean(np.abs(_since(film, film.confidence))),
                "mean confidence of false positives": mean(results.confidence[film.false], false),
            },
            "false positives": {
                "false positives": np.bincount(false, minlength=count),
                "second boxes and parts": np.bincount(false[film.second], minlength=count),
                "boxes around two vessels": np.bincount(results.image[film.around_two], minlength=count),
                "share of false positives that go on": mean(film.goes_on, false),
                "mean log area of false positives": mean(np.log(np.maximum(areas(film.false_boxes_px), 1)), false),
                "mean shape of false positives": mean(_shape(film.false_boxes_px), false),
                "mean height in the image of false positives": mean(
                    np.where(alone, centres(film.false_boxes_px)[:, 1] / height_px, np.nan), false
                ),
                "distance of false positives to vessels": mean(_to_nearest(film), false),
            },
        }
    )


def track_features(film: Sighted) -> Table:
    """A row for each vessel that is annotated in at least `MIN_IMAGES` images of a film, in order of identity."""
    identity = film.labelled.annotations.identity
    vessels, counts = np.unique(identity[identity >= 0], return_counts=True)
    rows = [np.flatnonzero(identity == vessel) for vessel in vessels[counts >= MIN_IMAGES]]
    contents = [_track(film, each) for each in rows] or [_track(film, np.empty(0, dtype=np.int64))]
    columns = {
        group: {name: np.array([each[group][name] for each in contents]) for name in names}
        for group, names in contents[0].items()
    }
    table = Table.of(columns)
    return table if rows else Table(table.names, table.groups, table.values[:0])


def _track(film: Sighted, rows: Indices) -> Mapping[str, Mapping[str, float]]:
    """The features of one vessel, given its annotations in order of time."""
    hit, error, confidence = film.hit[rows], film.error[rows], film.confidence[rows]
    gaps, sightings = _runs(~hit), _runs(hit)
    inner = gaps[1 if len(hit) and not hit[0] else 0 : len(gaps) - (1 if len(hit) and not hit[-1] else 0)]
    small, hidden, clear = (mask[rows] for mask in _kinds(film))
    followed = film.previous[rows] >= 0
    earlier, later = film.previous[rows][followed], rows[followed]
    size = np.log(np.maximum(areas(film.boxes_px[rows]), 1))
    half = len(rows) // 2
    errors: dict[str, float] = {}
    for k, side in enumerate(SIDES):
        errors |= {
            f"mean error of {side}": _mean(error[:, k]),
            f"spread of the error of {side}": _spread(error[:, k]),
            f"greatest error of {side}": _most(np.abs(error[:, k] - _mean(error[:, k]))),
            f"correlation in time of the error of {side}": _correlation(film.error[earlier, k], film.error[later, k]),
        }
    return {
        "scene": {
            "images": len(rows),
            "mean visible fraction": _mean(film.visible[rows]),
            "least visible fraction": -_most(-film.visible[rows]),
            "mean width": _mean(sizes(film.boxes_px[rows])[:, 0]),
        },
        "misses": {
            "share of images detected": _mean(hit),
            "share detected in clear view": _mean(hit[clear]),
            "share detected when hidden": _mean(hit[hidden]),
            "share detected when small": _mean(hit[small]),
            "share detected, second half less first": _mean(hit[half:]) - _mean(hit[:half]),
            "gaps for each image": len(inner) / max(len(rows), 1),
            "mean gap": _mean(inner),
            "longest gap": _most(inner),
            "longest stretch of sightings": _most(sightings),
            "correlation in time of misses": _correlation(film.hit[earlier], film.hit[later]),
        },
        "box errors": errors
        | {
            "mean IoU": _mean(film.overlap[rows]),
            "correlation of the errors of width and height": _correlation(error[:, 2], error[:, 3]),
            "correlation of the errors of x and width": _correlation(error[:, 0], error[:, 2]),
            "correlation of the errors of y and height": _correlation(error[:, 1], error[:, 3]),
        },
        "confidence": {
            "mean confidence": _mean(confidence),
            "spread of confidence": _spread(confidence),
            "least confidence": -_most(-confidence),
            "greatest confidence": _most(confidence),
            "correlation in time of confidence": _correlation(film.confidence[earlier], film.confidence[later]),
            "correlation of confidence and visible fraction": _correlation(confidence, film.visible[rows]),
            "correlation of confidence and size": _correlation(confidence, size),
            "correlation of confidence and IoU": _correlation(confidence, film.overlap[rows]),
        },
    }


def stacked(tables: Sequence[Table]) -> Table:
    """Tables of the same columns, one below the other."""
    return Table(tables[0].names, tables[0].groups, np.concatenate([each.values for each in tables]))


def _kinds(film: Sighted) -> tuple[Mask, Mask, Mask]:
    """Whether each annotation is small, is hidden, and is large and in clear view, shapes (T,)."""
    small = sizes(film.boxes_px)[:, 0] < SMALL_PX
    return small, film.visible < HIDDEN, ~small & (film.visible >= CLEAR)


def _means(values: Array | Mask, rows: Indices, count: int) -> Array:
    """Mean of the known values of each row, NaN where there are none, shape (count,)."""
    known = np.isfinite(values.astype(np.float64))
    number = np.bincount(rows[known], minlength=count)
    total = np.bincount(rows[known], values[known], minlength=count)
    mean: Array = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    return mean


def _extremes(values: Array, rows: Indices, count: int, extreme: np.ufunc) -> Array:
    """Least or greatest known value of each row, NaN where there is none, shape (count,)."""
    found = np.full(count, np.nan)
    extreme.at(found, rows, values)
    return found


def _since(film: Sighted, values: Array) -> Array:
    """Change of a value since the image before, NaN where it is not known in both, shape of the values."""
    known = (film.previous >= 0).reshape(-1, *[1] * (values.ndim - 1))
    change: Array = np.where(known, values - values[film.previous], np.nan) if len(values) else values
    return change


def _shape(boxes_px: Array) -> Array:
    """Logarithm of width over height, shape (n,)."""
    sides = np.maximum(sizes(boxes_px), 0.5)
    shape: Array = np.log(sides[:, 0] / sides[:, 1])
    return shape


def _to_nearest(film: Sighted) -> Array:
    """Distance of each false positive's centre to the nearest vessel's, in image widths; NaN without one, (f,)."""
    first, vessel = pairs_of_images(film.false_image, film.image)
    apart = np.hypot(*(centres(film.false_boxes_px[first]) - centres(film.boxes_px[vessel])).T)
    width_px = film.labelled.images.sizes_px[film.false_image, 0]
    nearest: Array = _extremes(apart, first, len(film.false), np.fmin) / width_px
    return nearest


def _runs(chosen: Mask) -> Indices:
    """Lengths of the stretches in which a mask is true, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8)))
    return edges[1::2] - edges[::2]


def _known(values: ArrayLike) -> Array:
    values = np.asarray(values, dtype=np.float64)
    known: Array = values[np.isfinite(values)]
    return known


def _mean(values: ArrayLike) -> float:
    known = _known(values)
    return float(known.mean()) if len(known) else np.nan


def _spread(values: ArrayLike) -> float:
    known = _known(values)
    return float(known.std(ddof=1)) if len(known) > 2 else np.nan


def _most(values: ArrayLike) -> float:
    known = _known(values)
    return float(known.max()) if len(known) else np.nan


def _correlation(a: ArrayLike, b: ArrayLike) -> float:
    """Of two columns, NaN with fewer than four known pairs or where one of them does not vary."""
    pairs = np.array([a, b], dtype=np.float64)
    pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
    if pairs.shape[1] < 4 or pairs.std(axis=1).min() < 1e-9:
        return np.nan
    return float(np.corrcoef(*pairs)[0, 1])
