"""Persistent box errors, simulated many times: how much their measured statistics vary by chance.

The latent normal numbers of a vessel are a first-order autoregressive process over the camera's frames; an error that
would leave no box is resampled without changing the process. How much correlation this leaves depends on every box, so
it is simulated: the errors of the same detections, many times.
"""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.error_distributions import ERROR_NORMALS, standardised
from modsim3d.verify.error_fit import ErrorSample
from modsim3d.verify.error_parameters import ErrorParameters

REPLAYS = 300
_MOST_DRAWS = 2000


def latent_paths(
    tracks: Indices,
    times_s: Array,
    correlation_s: float,
    rng: np.random.Generator,
    count: int,
    width: int = ERROR_NORMALS,
) -> Array:
    """Standard normal numbers of every row that persist along its track, shape (count, n, width).

    Args:
        tracks: Equal in rows of one track, shape (n, k).
        times_s: Shape (n,).
        correlation_s: Time in which the correlation falls to 1/e.
        rng: Random numbers.
        count: Number of replays.
        width: Numbers a row.
    """
    order = np.lexsort((times_s, *tracks.T[::-1]))
    starts = np.append(True, (tracks[order][1:] != tracks[order][:-1]).any(axis=1))
    apart = np.diff(times_s[order], prepend=0.0)
    kept = np.where(starts, 0.0, np.exp(-np.maximum(apart, 0) / correlation_s))
    paths = rng.standard_normal((len(order), count, width))
    for i in np.flatnonzero(kept > 0).tolist():
        paths[i] = kept[i] * paths[i - 1] + np.sqrt(1 - kept[i] ** 2) * paths[i]
    result = np.empty_like(paths)
    result[order] = paths
    return np.swapaxes(result, 0, 1)


def replayed_errors(law: ErrorParameters, sample: ErrorSample, latent: Array, rng: np.random.Generator) -> Array:
    """Errors in the law's standard deviations, shape (count, n, 4), of a sample's boxes from latent numbers."""
    boxes, images = sample.boxes_px[sample.rows], sample.images_px[sample.rows]
    means, stds = law.at(boxes)
    root = own_root(law)
    standard = standardised(law.distribution, latent) @ root.T
    bad = np.nonzero(~_accepted(means + stds * standard, boxes, images))
    for _ in range(_MOST_DRAWS):
        if not len(bad[0]):
            break
        rows = bad[1]
        drawn = standardised(law.distribution, rng.standard_normal((len(rows), latent.shape[-1]))) @ root.T
        standard[bad] = drawn
        wrong = ~_accepted(means[rows] + stds[rows] * drawn, boxes[rows], images[rows])
        bad = bad[0][wrong], bad[1][wrong]
    return standard


def own_root(law: ErrorParameters) -> Array:
    """Matrix from latent numbers to standardised errors, by the root of the file's covariance, shape (4, 4)."""
    covariance = law.correlation * np.outer(law.std, law.std)
    return symmetric_root(covariance) / law.std[:, None]


def _accepted(errors: Array, boxes: Array, images: Array) -> Mask:
    """Whether boxes (n, 4) with errors (..., n, 4), clipped, are at least a pixel wide and high, shape (..., n)."""
    half = errors[..., 2:] / 2
    low = np.maximum(boxes[:, :2] + errors[..., :2] - half, 0)
    high = np.minimum(boxes[:, 2:] + errors[..., :2] + half, images)
    return np.asarray((high - low >= 1 - 1e-9).all(axis=-1), dtype=bool)


def products(whitened: Array, now: Indices, before: Indices) -> Array:
    """Mean product of whitened errors with those one frame before, shape (...,); 0 if there are no pairs."""
    if not len(now):
        return np.zeros(whitened.shape[:-2])
    result: Array = (whitened[..., now, :] * whitened[..., before, :]).mean(axis=(-2, -1))
    return result
