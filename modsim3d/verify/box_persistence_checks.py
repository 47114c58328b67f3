"""How long box errors persist, and how far persistent box errors make all other estimates stray.

The latent normal numbers of a vessel are a first-order autoregressive process over the camera's frames; an error that
would leave no box is resampled without changing the process. How much correlation this leaves depends on every box, so
it is simulated: the errors of the same detections are drawn many times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import inside_image, move
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.box_error_law import ERROR_NORMALS, standardised
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import Persistence, with_share
from modsim3d.verify.error_fit import ErrorSample, StateFit
from modsim3d.verify.error_parameters import ErrorParameters
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.measures import CORRELATION, Estimate
from modsim3d.verify.pairs import turn_before

LEAST_PAIRS = 100
_REPLAYS, _REPLAYS_AT_ONCE = 300, 50
_MOST_DRAWS = 2000
_KNOWN, _LEAST_SHARE = 10.0, 1e-3


@dataclass(frozen=True, eq=False)
class Replayed:
    """What many replays of the same detections' errors say.

    Attributes:
        errors: Standard errors of each state's step, shapes (p,).
        products: Mean product of whitened errors with those one frame before, in each replay, shape (replays,).
    """

    errors: list[Array]
    products: Array


def replay(model: DetectorModel, evidence: Evidence, fits: list[StateFit]) -> Replayed | None:
    """Draw persistent errors of the same detections many times; None if there are none."""
    if not fits:
        return None
    rng = np.random.default_rng(0)
    tracks, times_s = evidence.instances.tracks(_instances_of(evidence, fits))
    now, before = _frame_pairs(model, evidence, fits)
    ends = np.cumsum([0, *(len(fit.rows) for fit in fits)])
    steps: list[list[Array]] = [[] for _ in fits]
    found = []
    width = ERROR_NORMALS + max(fit.law.distribution.extra_normals for fit in fits)
    for _ in range(0, _REPLAYS, _REPLAYS_AT_ONCE):
        latent = latent_paths(tracks, times_s, model.persistence, rng, _REPLAYS_AT_ONCE, width)
        whitened = np.empty((_REPLAYS_AT_ONCE, len(times_s), 4))
        for k, fit in enumerate(fits):
            ours = slice(ends[k], ends[k + 1])
            statistics = fit.law.statistics(replayed_errors(fit.law, fit.sample, latent[:, ours], rng))
            steps[k].append(fit.step.step_of(statistics))
            residual = statistics[..., :4] - fit.step.expected[:, :4]
            whitened[:, ours] = np.einsum("nij,cnj->cni", fit.step.roots, residual, optimize=True)
        found.append(_products(whitened, now, before))
    return Replayed([np.concatenate(step).std(axis=0) for step in steps], np.concatenate(found))


def box_persistence(
    model: DetectorModel, evidence: Evidence, fits: list[StateFit], replayed: Replayed | None
) -> Estimate | None:
    """Correlation of latent numbers with those of the same vessel one frame before."""
    if not fits:
        return None
    now, before = _frame_pairs(model, evidence, fits)
    if len(now) < LEAST_PAIRS:
        return None
    # A wrong mean or spread would look like a correlation, so the sample's own are removed.
    whitened = np.concatenate([_own_scale(fit.step.whitened) for fit in fits])
    product = float(_products(whitened, now, before))
    if replayed is None:
        asked, left, error, known = 0.0, 0.0, (4 * len(now)) ** -0.5, math.inf
    else:
        times_s = evidence.instances.time_s[_instances_of(evidence, fits)]
        share = model.persistence.box_vessel_share
        asked = share + (1 - share) * float(_kept(times_s[now] - times_s[before], model.persistence.box_s).mean())
        left, error = float(replayed.products.mean()), float(replayed.products.std())
        known = error / math.sqrt(len(replayed.products))
    # Truncation leaves part of a correlation: replays show which, or the boxes do where the correlation is small.
    share = left / asked if abs(left) > _KNOWN * known else float(_shares_left(fits, now, before).mean())
    scale = 1 / max(share, _LEAST_SHARE)
    off = product - left
    return Estimate(asked + off * scale, asked, error * scale, len(now), statistic=off / error, possible=CORRELATION)


def _instances_of(evidence: Evidence, fits: list[StateFit]) -> Indices:
    """Row of `Instances` of each error of all fits, one fit after the other, shape (n,)."""
    rows: Indices = evidence.true_detections.instance[np.concatenate([fit.rows for fit in fits])]
    return rows


def _frame_pairs(model: DetectorModel, evidence: Evidence, fits: list[StateFit]) -> tuple[Indices, Indices]:
    """Pairs of errors of one vessel, one turn of the detector apart: places in the rows of all fits, shapes (m,)."""
    chance = _instances_of(evidence, fits)
    place = np.full(len(evidence.instances.state), -1)
    place[chance] = np.arange(len(chance))
    before = turn_before(model, evidence)[chance]
    before = np.where(before >= 0, place[before], -1)
    now = np.flatnonzero(before >= 0)
    return now, before[now]


def _products(whitened: Array, now: Indices, before: Indices) -> Array:
    """Mean product of whitened errors with those one frame before, shape (...,); 0 if there are no pairs."""
    if not len(now):
        return np.zeros(whitened.shape[:-2])
    result: Array = (whitened[..., now, :] * whitened[..., before, :]).mean(axis=(-2, -1))
    return result


def _shares_left(fits: list[StateFit], now: Indices, before: Indices) -> Array:
    """How much of a small correlation of latent numbers is left between whitened errors of pairs, shape (m,).

    A first draw that counts has w = R (s − E s) and s = S z with the latent numbers z; a resampled one does not depend
    on them. So E[w zᵀ] = α R C S⁻ᵀ, where R C Rᵀ = 1, times the distribution's `latent_share`; and
    E[w · w′] = ρ tr(E[w zᵀ] E[w′ zᵀ]ᵀ) where z and z′ are correlated by a small ρ.
    """
    gains = []
    for fit in fits:
        inverse = np.linalg.inv(_root(fit.law))
        left = np.swapaxes(np.linalg.inv(fit.step.roots), 1, 2) @ inverse.T
        share = fit.law.likelihood.latent_share(fit.law.distribution)
        gains.append(share * fit.step.acceptance[:, None, None] * left)
    gain = np.concatenate(gains)
    shares: Array = np.einsum("mij,mij->m", gain[now], gain[before]) / 4
    return shares


def _own_scale(whitened: Array) -> Array:
    """Scaled to have sample mean zero and sample variance one, shape (n, 4)."""
    scaled: Array = (whitened - whitened.mean(axis=0)) / np.maximum(whitened.std(axis=0), 1e-12)
    return scaled


def latent_paths(
    tracks: Indices, times_s: Array, persistence: Persistence, rng: np.random.Generator, count: int, width: int
) -> Array:
    """Standard normal numbers that persist along tracks, for `count` replays of n rows, shape (count, n, width).

    Rows of `tracks`, shape (n, k), are equal in one track; times have shape (n,). Each track keeps its share of the
    numbers behind errors.
    """
    order = np.lexsort((times_s, *tracks.T[::-1]))
    starts = np.append(True, (tracks[order][1:] != tracks[order][:-1]).any(axis=1))
    apart = np.diff(times_s[order], prepend=0.0)
    kept = np.where(starts, 0.0, _kept(np.maximum(apart, 0), persistence.box_s))
    paths = rng.standard_normal((len(order), count, width))
    for i in np.flatnonzero(kept > 0).tolist():
        paths[i] = kept[i] * paths[i - 1] + np.sqrt(1 - kept[i] ** 2) * paths[i]
    if persistence.box_vessel_share:
        own = rng.standard_normal((int(starts.sum()), count, ERROR_NORMALS))[np.cumsum(starts) - 1]
        paths[..., :ERROR_NORMALS] = with_share(persistence.box_vessel_share, own, paths[..., :ERROR_NORMALS])
    result = np.empty_like(paths)
    result[order] = paths
    return np.swapaxes(result, 0, 1)


def _kept(apart_s: Array, correlation_s: float) -> Array:
    """What is left of a correlation after some time, shape of the times; nothing where noise does not persist."""
    kept: Array = np.exp(-apart_s / correlation_s) if correlation_s > 0 else np.zeros(np.shape(apart_s))
    return kept


def replayed_errors(law: ErrorParameters, sample: ErrorSample, latent: Array, rng: np.random.Generator) -> Array:
    """Errors in the law's standard deviations, shape (count, n, 4), of a sample's boxes from latent numbers."""
    boxes, images = sample.boxes_px[sample.rows], sample.images_px[sample.rows]
    means, stds = law.at(boxes)
    root = _root(law)
    standard = standardised(law.distribution, latent) @ root.T
    bad = np.nonzero(~inside_image(move(boxes, means + stds * standard), images))
    for _ in range(_MOST_DRAWS):
        if not len(bad[0]):
            break
        rows = bad[1]
        drawn = standardised(law.distribution, rng.standard_normal((len(rows), latent.shape[-1]))) @ root.T
        standard[bad] = drawn
        wrong = ~inside_image(move(boxes[rows], means[rows] + stds[rows] * drawn), images[rows])
        bad = bad[0][wrong], bad[1][wrong]
    return standard


def _root(law: ErrorParameters) -> Array:
    """Matrix from latent numbers to standardised errors, by the root of the file's covariance, shape (4, 4)."""
    covariance = law.correlation * np.outer(law.std, law.std)
    return symmetric_root(covariance) / law.std[:, None]
