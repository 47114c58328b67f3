"""What the edges of a box leave open: points of its censored and left-out edges, given those that are known.

Known edges come first, then censored ones, then those that are left out. Each is drawn given those before it, censored
ones beyond their least value (Genz (1992)), at points of Sobol's sequence that are the same in every call. Heavy tails
are normal errors with a random scale, which is drawn first, given the known edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.learn.box_error_fits.error_model import ErrorModel
from modsim3d.learn.box_error_fits.gate_passing import sobol
from modsim3d.learn.box_error_fits.matched_edges import ERRORS, OUTWARD, MatchedEdges

_POINTS = 64
_POINTS_IN_ALL = 1 << 18


@dataclass(frozen=True, eq=False)
class Completed:
    """Edges of some boxes, with points in place of what is open.

    Attributes:
        rows: The boxes, shape (m,).
        outward_px: How far each edge lies outside the true one, shape (m, p, 4).
        weights: Of each point, sum to one, shape (m, p).
        log_likelihood: Of the known and censored edges, shape (m,).
    """

    rows: Indices
    outward_px: Array
    weights: Array
    log_likelihood: Array


def standard_errors(model: ErrorModel, sides_px: Array, outward_px: Array) -> Array:
    """Standardised errors from edges (m, p, 4) of boxes of width, height, width, height (m, 4)."""
    mean, std = model.at(sides_px)
    result: Array = (outward_px @ ERRORS.T - mean[:, None]) / std[:, None]
    return result


def completed(model: ErrorModel, edges: MatchedEdges) -> Iterator[Completed]:
    """All boxes, those with the same edges known together."""
    for rows, ours in edges.alike:
        yield _of_pattern(model, ours, rows)


def _of_pattern(model: ErrorModel, edges: MatchedEdges, rows: Indices) -> Completed:
    """Boxes of which the same edges are known and censored, and their rows."""
    known, censored = edges.known[0], edges.censored[0]
    order = np.argsort(np.where(known, 0, np.where(censored, 1, 2)), kind="stable")
    count, ends = int(known.sum()), int(known.sum() + censored.sum())
    mean, std = model.at(edges.sides_px)
    turn = OUTWARD[order]
    scaled = turn * std[:, None]
    root = np.linalg.cholesky(scaled @ model.correlation @ np.swapaxes(scaled, 1, 2))
    moved = edges.outward_px[:, order] - mean @ turn.T
    zeta = np.zeros((len(rows), 4))
    for j in range(count):
        zeta[:, j] = (moved[:, j] - (root[:, j, :j] * zeta[:, :j]).sum(axis=1)) / root[:, j, j]
    value = _log_density(model, zeta[:, :count]) - np.log(np.diagonal(root[:, :count, :count], axis1=1, axis2=2)).sum(1)
    if count == 4:
        return Completed(rows, edges.outward_px[:, None], np.ones((len(rows), 1)), value)
    uniforms = _uniforms(len(rows), 4 - count + model.heavy)
    points, scale = np.zeros((*uniforms.shape[:2], 4)), np.ones(uniforms.shape[:2])
    points[..., :count] = zeta[:, None, :count]
    if model.heavy:
        nu, q = model.freedom, (zeta[:, :count] ** 2).sum(axis=1)[:, None]
        chi_square = 2 * special.gammaincinv((nu + count) / 2, uniforms[..., -1]) / (1 + q / (nu - 2))
        scale = np.sqrt((nu - 2) / chi_square)
    weights = np.ones(uniforms.shape[:2])
    for j in range(count, 4):
        least = -np.inf
        if j < ends:
            given = np.einsum("mk,mpk->mp", root[:, j, :j], points[..., :j])
            least = (moved[:, j, None] - given) / (root[:, j, j, None] * scale)
        beyond = special.ndtr(-least)  # the probability
        points[..., j] = -scale * special.ndtri(np.maximum(uniforms[..., j - count] * beyond, 1e-300))
        weights *= beyond
    total = weights.mean(axis=1)
    outward = np.empty_like(points)
    outward[..., order] = np.einsum("mjk,mpk->mpj", root, points) + (mean @ turn.T)[:, None]
    if ends < 4:
        passes = edges.passes(outward)
        weights = np.where(passes.any(axis=1, keepdims=True), weights * passes, weights)
        total = np.maximum(weights.mean(axis=1), 1e-300)
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    return Completed(rows, outward, weights, value + np.log(np.maximum(total, 1e-300)))


@lru_cache(maxsize=128)
def _uniforms(count: int, width: int) -> Array:
    """Points of Sobol's sequence for each of so many boxes, shifted by an amount of its own, (count, p, width)."""
    points = max(8, min(_POINTS, 1 << int(np.log2(max(_POINTS_IN_ALL / count, 8)))))
    shifted: Array = (sobol(points, width) + np.random.default_rng(1).random((count, 1, width))) % 1
    uniforms: Array = np.clip(shifted, 1e-12, 1 - 1e-12)
    uniforms.flags.writeable = False
    return uniforms


def _log_density(model: ErrorModel, zeta: Array) -> Array:
    """Log-density of standardised independent numbers (m, k), shape (m,)."""
    k, q = zeta.shape[1], (zeta**2).sum(axis=1)
    if not model.heavy:
        return np.asarray(-q / 2 - k / 2 * np.log(2 * np.pi))
    nu = model.freedom
    constant = special.gammaln((nu + k) / 2) - special.gammaln(nu / 2) - k / 2 * np.log(np.pi * (nu - 2))
    return np.asarray(constant - (nu + k) / 2 * np.log1p(q / (nu - 2)))
