"""Checks of how long box errors persist, and standard errors of all other tests of persistent box errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.error_distributions import ERROR_NORMALS
from modsim3d.detector.model import DetectorModel
from modsim3d.verify.error_fit import StateFit
from modsim3d.verify.error_replay import REPLAYS, latent_paths, own_root, products, replayed_errors
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.measures import Estimate
from modsim3d.verify.pairs import turn_before

LEAST_PAIRS = 100
_REPLAYS_AT_ONCE = 50
_KNOWN, _LEAST_SHARE = 10.0, 1e-3


@dataclass(frozen=True, eq=False)
class Replayed:
    """Statistics of replayed errors.

    Attributes:
        errors: Standard errors of each state's step, shapes (p,).
        products: Mean products with the frame before, of each replay, shape (replays,).
    """

    errors: list[Array]
    products: Array


def _frame_pairs(model: DetectorModel, evidence: Evidence, fits: list[StateFit]) -> tuple[Indices, Indices]:
    """Pairs of detections of one vessel, one turn of the detector apart: places in the joined rows of the fits."""
    rows = np.concatenate([fit.rows for fit in fits])
    chance = evidence.true_detections.instance[rows]
    place = np.full(len(evidence.instances.state), -1)
    place[chance] = np.arange(len(rows))
    before = turn_before(model, evidence)[chance]
    before = np.where(before >= 0, place[before], -1)
    now = np.flatnonzero(before >= 0)
    return now, before[now]


def replay(model: DetectorModel, evidence: Evidence, fits: list[StateFit]) -> Replayed | None:
    """Simulate the errors of the same detections many times; None if there are none."""
    if not fits:
        return None
    rng = np.random.default_rng(0)
    instances = evidence.instances
    chance = np.concatenate([evidence.true_detections.instance[fit.rows] for fit in fits])
    tracks = np.stack([instances.camera[chance], instances.vessel[chance]], axis=1)
    now, before = _frame_pairs(model, evidence, fits)
    ends = np.cumsum([0, *(len(fit.rows) for fit in fits)])
    steps: list[list[Array]] = [[] for _ in fits]
    found = []
    width = ERROR_NORMALS + max(fit.law.distribution.extra_normals for fit in fits)
    for _ in range(0, REPLAYS, _REPLAYS_AT_ONCE):
        latent = latent_paths(tracks, instances.time_s[chance], model.persistence.box_s, rng, _REPLAYS_AT_ONCE, width)
        whitened = np.empty((_REPLAYS_AT_ONCE, len(chance), 4))
        for k, fit in enumerate(fits):
            ours = slice(ends[k], ends[k + 1])
            standard = replayed_errors(fit.law, fit.sample, latent[:, ours], rng)
            statistics = fit.law.statistics(standard)
            steps[k].append(fit.step.step_of(statistics))
            residual = statistics[..., :4] - fit.step.expected[:, :4]
            whitened[:, ours] = np.einsum("nij,cnj->cni", fit.step.roots, residual, optimize=True)
        found.append(products(whitened, now, before))
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
    product = float(products(whitened, now, before))
    if replayed is None:
        asked, left, error, known = 0.0, 0.0, (4 * len(now)) ** -0.5, math.inf
    else:
        instances = evidence.instances
        rows = np.concatenate([evidence.true_detections.instance[fit.rows] for fit in fits])
        apart = instances.time_s[rows[now]] - instances.time_s[rows[before]]
        asked = float(np.exp(-apart / model.persistence.box_s).mean())
        left, error = float(replayed.products.mean()), float(replayed.products.std())
        known = error / math.sqrt(len(replayed.products))
    # Truncation leaves part of a correlation: replays show which, or the boxes do where the correlation is small.
    share = left / asked if abs(left) > _KNOWN * known else float(_shares_left(fits, now, before).mean())
    scale = 1 / max(share, _LEAST_SHARE)
    return Estimate(
        asked + (product - left) * scale, asked, error * scale, len(now), statistic=(product - left) / error
    )


def _shares_left(fits: list[StateFit], now: Indices, before: Indices) -> Array:
    """How much of a small correlation of latent numbers is left between whitened errors of pairs, shape (m,).

    A first draw that counts has w = R (s − E s) and s = S z with the latent numbers z; a resampled one does not depend
    on them. So E[w zᵀ] = α R C S⁻ᵀ, where R C Rᵀ = 1, times the distribution's `latent_share`; and
    E[w · w′] = ρ tr(E[w zᵀ] E[w′ zᵀ]ᵀ) where z and z′ are correlated by a small ρ.
    """
    gains = []
    for fit in fits:
        inverse = np.linalg.inv(own_root(fit.law))
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
