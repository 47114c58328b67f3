"""Precision of the values, when errors of one vessel's boxes go together.
Box errors of a vessel are correlated in time, and its dimensions, its antenna and the delay of its reports are wrong in
all frames alike. So vessels are the clusters of a sandwich covariance, with the bias-reduced correction CR2 and the
degrees of freedom of Bell & McCaffrey (2002), "Bias reduction in standard errors for linear regression with multi-stage
samples", Survey Methodology 28. What rests on few vessels gets few degrees of freedom and so a wide interval. A second
sandwich, with stretches of time of a vessel as clusters, bounds it from below, because what one vessel alone determines
leaves no residual by which the first could judge. With offsets of vessels, so does what their spreads would give."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student_t

from modsim3d.core.arrays import Array, Indices
from modsim3d.learn.voyage.registration.parameters import SHARED, plausible

LEVEL = 0.95
MAX_DEGREES = 1e4
FULL = 1e-9


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Precision of p estimated values."""

    covariance: Array  # (p, p)
    half_widths: Array  # half of the 95 % interval of each, (p,)
    errors: Array  # standard error of each, (p,)


@dataclass(frozen=True, eq=False)
class Linear:
    """A fit as a linear regression with unit errors: what its covariance follows from."""

    slopes: Array  # derivatives of the scaled residuals, (m, p)
    residuals: Array  # scaled, as the loss takes them, (m,)

    @classmethod
    def of_soft_loss(cls, slopes: Array, residuals: Array, soft: float) -> Linear:
        """The regression that a fit with the soft loss equals near its solution. With the influence
        ψ(r) = r / √(1 + (r / soft)²), the information is the mean of ψ' times the slopes' product."""
        growth = 1 + (residuals / soft) ** 2
        kept = float(np.mean(growth**-1.5)) if len(residuals) else 1.0
        return cls(np.sqrt(kept) * slopes, residuals / np.sqrt(growth) / np.sqrt(kept))

    def whitened(self, shared: Array, cluster: Indices) -> Linear:
        """Regression whose rows share errors in a cluster: `shared` holds their standard deviations, shape (m, q).
        Their covariance is 1 + Z Zᵀ; the rows are multiplied by its inverse root."""
        slopes, residuals = self.slopes.copy(), self.residuals.copy()
        for rows in clusters(cluster):
            basis, upper = np.linalg.qr(shared[rows])
            spread, turn = np.linalg.eigh(upper @ upper.T)
            axes = basis @ turn
            less = 1 / np.sqrt(1 + np.maximum(spread, 0.0)) - 1
            slopes[rows] += axes @ (less[:, None] * (axes.T @ slopes[rows]))
            residuals[rows] += axes @ (less * (axes.T @ residuals[rows]))
        return Linear(slopes, residuals)

    @property
    def information(self) -> Array:
        """Shape (p, p)."""
        return self.slopes.T @ self.slopes

    def known_by(self, cluster: Indices, degrees: float | None = None) -> Knowledge:
        """Covariance and intervals with clusters of rows, shape (m,), and degrees of freedom if they are known."""
        bread = np.linalg.pinv(self.information, hermitian=True)
        scores, reaches, squares = [], [], []
        for rows in clusters(cluster):
            basis, upper = np.linalg.qr(self.slopes[rows])
            left, axes = np.linalg.eigh(np.eye(len(upper)) - upper @ bread @ upper.T)
            root = np.where(left > FULL, 1 / np.sqrt(np.maximum(left, FULL)), 0.0)
            adjusted = axes @ (root[:, None] * (axes.T @ upper))
            scores.append(adjusted.T @ (basis.T @ self.residuals[rows]))
            weights = adjusted @ bread  # in the basis of the cluster, one column a value
            reaches.append(upper.T @ weights)
            squares.append((weights**2).sum(axis=0))
        sums = np.array(scores)
        covariance = bread @ (sums.T @ sums) @ bread
        errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        found = _degrees(np.array(reaches), np.array(squares), np.asarray(bread, dtype=np.float64))
        half = errors * student_t.ppf((1 + LEVEL) / 2, found if degrees is None else degrees)
        return Knowledge(covariance, half, errors)

    def known_by_model(self, together: float, degrees: float) -> Knowledge:
        """Covariance and intervals if the rows' errors are as the whitening has them. `together` rows count as one, and
        the spreads of what vessels share have so many degrees of freedom."""
        covariance = together * np.linalg.pinv(self.information, hermitian=True)
        errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        return Knowledge(np.asarray(covariance), errors * student_t.ppf((1 + LEVEL) / 2, degrees), errors)


def wider(first: Knowledge, second: Knowledge) -> Knowledge:
    """Wider interval of each value, with the error that goes with it; the covariance is scaled to the errors."""
    errors = np.where(first.half_widths >= second.half_widths, first.errors, second.errors)
    scale = errors / np.maximum(np.sqrt(np.diagonal(first.covariance)), 1e-300)
    scale = np.where(np.isfinite(scale), scale, 1.0)
    covariance = first.covariance * scale[:, None] * scale
    return Knowledge(covariance, np.maximum(first.half_widths, second.half_widths), errors)


def _degrees(reaches: Array, squares: Array, bread: Array) -> Array:
    """Degrees of freedom of each value, (p,), from unit errors (Bell & McCaffrey, 2002). The variance estimate is a sum
    of squares of correlated normals, one for each cluster; its first two moments are those of a scaled chi-square.
    `reaches` are slopes times weights of each cluster, (clusters, p, p), `squares` squared weights, (clusters, p), and
    `bread` the inverse of the information, (p, p)."""
    degrees = np.empty(squares.shape[1])
    for value in range(len(degrees)):
        reach = reaches[:, :, value]
        spread = np.diag(squares[:, value]) - reach @ bread @ reach.T
        total = np.trace(spread)
        degrees[value] = total**2 / max(float((spread**2).sum()), 1e-300)
    return np.clip(degrees, 1.0, MAX_DEGREES)


def covering(known: Knowledge, others: Sequence[Array]) -> Knowledge:
    """Intervals that also hold those about other values, which are so far from these, each of shape (p,)."""
    away = np.max(np.abs(others), axis=0, initial=0.0) if len(others) else 0.0
    return replace(known, half_widths=known.half_widths + away)


def clusters(cluster: Indices) -> Iterator[Indices]:
    """The rows of each cluster, in order of its number."""
    order = np.argsort(cluster, kind="stable")
    edges = np.flatnonzero(np.diff(cluster[order])) + 1
    yield from (part for part in np.split(order, edges) if len(part))


# ---- What the data determine, and what they cannot tell apart ----

COMMON_DELAY = "common_delay_s"
KNOWN = 0.5  # a value is determined if its standard error is below this share of its plausible distance
IN_GROUP = 0.2  # components of a singular vector, or exchanges in plausible distances, below this are left out
GIVEN_UP_FIRST = (  # of values that cannot be told apart, the first of these is held at the scene's
    *("k1", "mean_width_share", "mean_height_share", "mean_x_px", "mean_y_px"),
    *("roll_deg", "focal_share", "height_m", "pitch_deg", "yaw_deg", "clock_s"),
)


@dataclass(frozen=True)
class ConfoundedGroup:
    """Parameters that the data cannot tell apart."""

    held: str  # the one that is held
    exchange: tuple[tuple[str, float], ...]  # other names, and their changes when `held` grows by one of its units

    def words(self) -> str:
        """For example: `mean_y_px is held; 1 px of it looks like +0.044° of pitch_deg`."""
        units = {each.name: each.unit if each.unit in ("", "°") else f" {each.unit}" for each in SHARED}
        units[COMMON_DELAY] = " s"
        if not self.exchange:
            return f"{self.held}: the detections say nothing of it"
        one = "0.01" if units[self.held] == "" else "1"
        parts = [f"{change * float(one):+.3g}{units[name]} of {name}" for name, change in self.exchange]
        return f"{self.held} is held; {one}{units[self.held]} of it looks like {', '.join(parts)}"


def undetermined(linear: Linear, names: tuple[str, ...], cluster: Indices) -> list[ConfoundedGroup]:
    """Named values that are held because the data do not determine them, each with its group. The fit, in plausible
    distances, has a column for each name; `cluster` (m,) are stretches of time of a vessel, within which errors go
    together."""
    kept, groups = list(range(len(names))), []
    while kept:
        part = Linear(linear.slopes[:, kept], linear.residuals)
        turn, errors = directions(part, part.known_by(cluster))
        worst = int(np.argmax(errors))
        if errors[worst] < KNOWN:
            break
        members = [names[kept[i]] for i in np.flatnonzero(np.abs(turn[worst]) >= IN_GROUP)]
        given_up = next(name for name in GIVEN_UP_FIRST if name in members)
        kept.remove(names.index(given_up))
        groups.append(exchange(linear, names, given_up, [names[i] for i in kept if names[i] in members]))
    return groups


def directions(linear: Linear, known: Knowledge) -> tuple[Array, Array]:
    """Right singular vectors of the scaled Jacobian, shape (p, p), and the standard errors along them, shape (p,)."""
    _, singular, turn = np.linalg.svd(np.linalg.qr(linear.slopes)[1])
    rows = np.einsum("ki,ij,kj->k", turn, known.covariance, turn)
    errors = np.sqrt(np.maximum(rows, 0.0))
    return turn, np.maximum(errors, 1 / np.maximum(singular, 1e-12))


def exchange(linear: Linear, names: tuple[str, ...], held: str, others: list[str]) -> ConfoundedGroup:
    """Changes of others if a held value were another, from the least squares of the slopes."""
    if not others:
        return ConfoundedGroup(held, ())
    slope, slopes = linear.slopes[:, names.index(held)], linear.slopes[:, [names.index(name) for name in others]]
    share, *_ = np.linalg.lstsq(slopes, slope, rcond=None)
    own, *scales = plausible("delay_s" if name == COMMON_DELAY else name for name in (held, *others))
    changes = -share * scales / own
    carried = np.abs(share) * np.linalg.norm(slopes, axis=0) >= IN_GROUP * max(float(np.linalg.norm(slope)), 1e-300)
    return ConfoundedGroup(held, tuple((others[k], float(changes[k])) for k in np.flatnonzero(carried)))
