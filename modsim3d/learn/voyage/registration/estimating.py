"""The last fit: the camera together with what is wrong with single vessels, and how well each is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import ModsimError
from modsim3d.learn.voyage.registration import parameters
from modsim3d.learn.voyage.registration.icp import SOFT, Aligner, Alignment, SightingResiduals, Unknowns, derivatives
from modsim3d.learn.voyage.registration.parameters import COMMON_DELAY, Knowledge, Linear, clusters, wider
from modsim3d.learn.voyage.registration.parameters import NAMES as OF_A_VESSEL_NAMES

# ---- Errors of positions that last ----

LASTS_S = 300.0
KNOT_S, MAX_KNOTS = 3.0, 60  # the drift is linear between knots, of which a vessel has at most so many
TINY = 1e-9
ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Drift:
    """A linear fit of p values of the camera and of the vessels' drifts."""

    change: Array  # of the values, (p,)
    off: Array  # how far each row's vessel is off its reports, along and across in metres, and how late, (m, 3)
    steady: Array  # the same of a vessel that did not drift, so that it stays put among what is seen of it, (m, 3)
    errors_px: Array  # what is left of the residuals, (m,)
    spreads_px: Array  # of what is left of each row, (m,)


def drift_axes(time_s: Array, vessel: Indices, constant: Array, noise_m: float) -> Array:
    """Distances by which unit normals, each vessel's own, put the vessel of rows off: along and across in metres, late
    in s, (m, 3, q), given standard deviations of what is constant, (3,), and of the drift along and across."""
    parts = [(rows, _hats(time_s[rows])) for rows in clusters(vessel)]
    most = max((hats.shape[1] for _, hats in parts), default=0)
    drifting = np.zeros((len(time_s), 3, 2, most))
    for rows, hats in parts:
        for axis in range(2):
            drifting[rows, axis, axis, : hats.shape[1]] = noise_m * hats
    staying = np.tile(np.diag(constant), (len(time_s), 1, 1))
    return np.concatenate([drifting.reshape(len(time_s), 3, 2 * most), staying], axis=2)


def _hats(time_s: Array) -> Array:
    """A Gauss-Markov process of unit spread at n times, from unit normals, shape (n, K)."""
    first, last = float(time_s.min()), float(time_s.max())
    knots = np.linspace(first, last, int(min((last - first) // KNOT_S + 1, MAX_KNOTS)) + 1)
    root = np.linalg.cholesky(np.exp(-np.abs(knots[:, None] - knots) / LASTS_S) + TINY * np.eye(len(knots)))
    return np.stack([np.interp(time_s, knots, column) for column in root.T], axis=1)


def fit_drift(
    pairs: SightingResiduals, px: Array, first_px: Array, slopes_px: Array, own_px: Array, axes: Array, together: float
) -> Drift:
    """Fit p values of the camera, and where the vessels are. `px` (m,) are residuals with all vessels where their
    reports put them, and `first_px` what is left of them by the last fit. `slopes_px` (m, p) are derivatives by the
    values, and `own_px` (m, 3) by along, across and delay of the row's vessel, per metre and second; for `axes` see
    `drift_axes`. `together` rows count as one."""
    axes_px = (own_px[:, :, None] * axes).sum(axis=1)
    errors, change, normals = first_px, np.zeros(slopes_px.shape[1]), np.zeros(axes_px.shape)
    groups, p = list(clusters(pairs.vessel)), slopes_px.shape[1]
    for _ in range(ROUNDS):
        spreads = pairs.spreads_px(errors)
        weights = (1 + (errors / spreads / SOFT) ** 2) ** -0.25 / spreads
        shared = axes_px * weights[:, None] / np.sqrt(together)
        rows = np.column_stack([slopes_px, px]) * weights[:, None]
        products, inner = rows.T @ rows, []
        for own in groups:  # the covariance of a vessel's rows is 1 + Z Zᵀ; its inverse is Woodbury's
            crossed = shared[own].T @ rows[own]
            inner.append(np.linalg.solve(np.eye(shared.shape[1]) + shared[own].T @ shared[own], crossed))
            products -= crossed.T @ inner[-1]
        change = -np.linalg.pinv(products[:p, :p], hermitian=True) @ products[:p, p]
        for own, solved in zip(groups, inner, strict=True):
            normals[own] = -(solved[:, :p] @ change + solved[:, p]) / np.sqrt(together)
        errors = px + slopes_px @ change + (axes_px * normals).sum(axis=1)
    off = (axes * normals[:, None]).sum(axis=2)
    far = np.sqrt((axes**2).sum(axis=2).max(axis=0))[:2]
    rest = (px + slopes_px @ change + own_px[:, 2] * off[:, 2]) * weights
    steady = np.column_stack([_steady(rest, own_px[:, :2] * weights[:, None], groups, far), off[:, 2]])
    return Drift(change, off, steady, errors, spreads)


def _steady(rest: Array, slopes: Array, groups: Sequence[Indices], far_m: Array) -> Array:
    """One place along and across for all rows of a vessel, expected within so many metres (2,), shape (m, 2)."""
    steady = np.zeros(slopes.shape)
    for own in groups:
        pull = slopes[own].T @ rest[own]
        steady[own] = -np.linalg.solve(slopes[own].T @ slopes[own] + np.diag(1 / np.maximum(far_m, TINY) ** 2), pull)
    return steady


BLOCK_S = 10.0  # stretches of time within which a vessel's box errors are taken to go together
PROBED = (*parameters.SHARED_NAMES, "along_m", "across_m", COMMON_DELAY)
"""A common delay is a delay of all vessels; the columns of single vessels' values are the same, each for its rows."""
OWN = slice(len(parameters.SHARED_NAMES), len(PROBED))
DELAY_S = 0.5  # standard deviation, over vessels, of how late reports are, where offsets are expected
FIRST_M = 5.0  # that of constant errors in the first fit, where none are expected
EFFECT_ROUNDS, DRIFT_ROUNDS = 2, 6
SAME = 0.003  # the drifts stay if no value changes by more, in plausible distances


@dataclass(frozen=True, eq=False)
class LastFit:
    """The last fit."""

    aligned: Alignment
    linear: Linear  # near the values of the alignment, a column for each of `PROBED`
    effects: parameters.VesselEffects
    knowledge: Knowledge  # of the free shared values


def estimate(
    aligner: Aligner, aligned: Alignment, free: tuple[str, ...], offsets_m: float | None, noise_m: float
) -> LastFit:
    """Fit the free shared values with what is wrong with vessels; see `register` for the latter two."""
    if noise_m:
        return _with_drift(aligner, aligned, free, offsets_m, noise_m)
    aligned, effects, together = _with_effects(aligner, aligned, free, offsets_m)
    linear = linearized(aligner, aligned)
    return LastFit(aligned, linear, effects, _knowledge(linear, free, aligned, effects, together))


def linearized(aligner: Aligner, aligned: Alignment) -> Linear:
    """The fit as a regression in plausible distances, with a column for each of `PROBED`; ModsimError without any."""
    if not len(aligned.residuals.row):
        raise ModsimError("registration: no match is left")
    px, slopes = _px_and_slopes(aligner, aligned)
    spreads = aligned.spreads_px
    return Linear.of_soft_loss(slopes / spreads[:, None], px / spreads, SOFT)


def columns(linear: Linear, names: Sequence[str]) -> Array:
    """The slopes of named parameters, shape (m, len(names))."""
    return linear.slopes[:, [PROBED.index(name) for name in names]]


def blocks_of(residuals: SightingResiduals) -> Indices:
    """Stretches of time of each vessel, as numbers of clusters, shape (m,)."""
    times_s = residuals.sightings.time_s[residuals.row]
    stretch = ((times_s - times_s.min()) // BLOCK_S).astype(np.int64) if len(times_s) else np.empty(0, np.int64)
    return np.asarray(residuals.vessel * (stretch.max(initial=0) + 1) + stretch, dtype=np.int64)


def _px_and_slopes(aligner: Aligner, aligned: Alignment) -> tuple[Array, Array]:
    """Residuals in pixels, shape (m,), and derivatives by `PROBED` in plausible distances, (m, 14); 0 if unknown."""
    names = (*parameters.SHARED_NAMES, *OF_A_VESSEL_NAMES)
    slopes = derivatives(aligner.model, aligned.residuals, aligned.values, names) * parameters.plausible(names)
    px = aligned.residuals.px(aligner.model, aligned.values)
    return np.nan_to_num(px, nan=0.0), np.where(np.isfinite(px)[:, None] & np.isfinite(slopes), slopes, 0.0)


def _with_mean_speeds(aligner: Aligner, aligned: Alignment, slopes: Array) -> Array:
    """Slopes by the clock and by delays at vessels' mean speed of a minute, (m, 14): the speed between reports has
    errors of both, a pattern that would seem to set the clock."""
    residuals = aligned.residuals
    clock, delay = PROBED.index("clock_s"), PROBED.index(COMMON_DELAY)
    along, across, delay_s = parameters.plausible(OF_A_VESSEL_NAMES)
    time_s = residuals.sightings.time_s[residuals.row] + aligned.values["clock_s"]
    speeds_m_s = aligner.model.traffic.velocities(time_s, residuals.vessel)
    px_by_metre = slopes[:, OWN][:, :2] / (along, across)
    px_by_delay = -(px_by_metre * speeds_m_s).sum(axis=1)  # a late report puts the vessel too far back
    changed = slopes.copy()
    changed[:, clock] += (px_by_delay - slopes[:, delay] / delay_s) * parameters.plausible(["clock_s"])
    changed[:, delay] = px_by_delay * delay_s
    return changed


def _with_effects(
    aligner: Aligner, aligned: Alignment, free: tuple[str, ...], offsets_m: float | None
) -> tuple[Alignment, parameters.VesselEffects, float]:
    """The alignment with what is wrong with single vessels, and how many rows count as one."""
    for _ in range(EFFECT_ROUNDS):
        linear, residuals = linearized(aligner, aligned), aligned.residuals
        together = _rows_in_one(linear, free, residuals)
        effects = _effects(Linear(linear.slopes, _bare_errors(linear, aligned)), free, residuals, together, offsets_m)
        if not effects.spreads.any():
            break
        unknowns = Unknowns(free, effects.spreads / np.sqrt(together), effects.vessels)
        aligned = aligner.until_stable(aligned, unknowns, tied=False, rounds=2)
    return aligned, effects, together


def _effects(
    rows: Linear, free: tuple[str, ...], residuals: SightingResiduals, together: float, offsets_m: float | None
) -> parameters.VesselEffects:
    """Constant errors of vessels by rows with unit errors, whose residuals have all values of vessels zero."""
    own = rows.slopes[:, OWN] / parameters.plausible(OF_A_VESSEL_NAMES)
    return parameters.vessel_effects(own, rows.residuals, columns(rows, free), residuals.vessel, together, offsets_m)


def _rows_in_one(linear: Linear, free: tuple[str, ...], residuals: SightingResiduals) -> float:
    """Number of rows that count as one, because box errors last: the ratio of variances with and without clusters."""
    part = Linear(columns(linear, free), linear.residuals)
    alone = np.sqrt(np.diagonal(np.linalg.pinv(part.information, hermitian=True)))
    return max(float(np.median((part.known_by(blocks_of(residuals)).errors / np.maximum(alone, 1e-300)) ** 2)), 1.0)


def _bare_errors(linear: Linear, aligned: Alignment) -> Array:
    """Scaled residuals with all values of vessels zero, shape (m,)."""
    values = aligned.values.vessels[aligned.residuals.vessel] / parameters.plausible(OF_A_VESSEL_NAMES)
    return np.asarray(linear.residuals - (linear.slopes[:, OWN] * values).sum(axis=1))


def _knowledge(
    linear: Linear, free: tuple[str, ...], aligned: Alignment, effects: parameters.VesselEffects, together: float
) -> Knowledge:
    """Knowledge of the free shared values; vessels are clusters, and share what is wrong with them."""
    part = Linear(columns(linear, free), linear.residuals)
    blocks, vessel = blocks_of(aligned.residuals), aligned.residuals.vessel
    if not effects.spreads.any():
        return wider(part.known_by(vessel), part.known_by(blocks))
    spreads = effects.spreads / parameters.plausible(OF_A_VESSEL_NAMES) / np.sqrt(together)
    shared = Linear(part.slopes, _bare_errors(linear, aligned)).whitened(linear.slopes[:, OWN] * spreads, vessel)
    by_model = shared.known_by_model(together, float(len(effects.vessels)))
    return wider(wider(shared.known_by(vessel), shared.known_by(blocks)), by_model)


@dataclass(frozen=True, eq=False)
class _Round:
    aligned: Alignment  # the new values, with the matches of the old ones
    change: Array  # of the free shared values, in plausible distances, (p,)
    linear: Linear  # near the old values, a column for each of `PROBED`
    rows: Linear  # the same with the residuals that are left where all vessels are as they are reported
    axes: Array  # what unit normals of the row's vessel add, (m, q)
    drifts: Array  # the same without what is estimated of the constant errors, (m, r)


def _with_drift(
    aligner: Aligner, aligned: Alignment, free: tuple[str, ...], offsets_m: float | None, noise_m: float
) -> LastFit:
    """Estimate a drift of positions too, by nearly linear fits. Raises ModsimError if no match is left with it."""
    late = np.array([0.0, 0.0, 0.0 if offsets_m is None else DELAY_S])
    first_m = FIRST_M if offsets_m is None else offsets_m
    constant, together = np.array([first_m, first_m, 0.0]) + late, 1.0
    for _ in range(DRIFT_ROUNDS):
        matched = aligner.matched(aligned)
        if not len(matched.sightings):
            raise ModsimError(f"registration: no match is left where positions are off by {noise_m:g} m")
        fitted = _round(aligner, matched, free, constant, late, noise_m, together)
        aligned, rows, vessel = fitted.aligned, fitted.rows, fitted.aligned.residuals.vessel
        together = _rows_in_one(rows.whitened(fitted.axes / np.sqrt(together), vessel), free, aligned.residuals)
        steady = rows.whitened(fitted.drifts / np.sqrt(together), vessel)
        effects = _effects(steady, free, aligned.residuals, together, offsets_m)
        constant = effects.spreads + late
        if np.abs(fitted.change).max() < SAME:
            break
    white = Linear(columns(rows, free), rows.residuals).whitened(fitted.axes / np.sqrt(together), vessel)
    degrees = float(len(effects.vessels))
    knowledge = white.known_by_model(together, degrees)
    for cluster in (vessel, blocks_of(aligned.residuals)):
        knowledge = wider(knowledge, white.known_by(cluster, degrees))
    return LastFit(aligned, fitted.linear, effects, knowledge)


def _round(
    aligner: Aligner, start: Alignment, free: tuple[str, ...], std: Array, late: Array, noise_m: float, together: float
) -> _Round:
    """Fit shared values and places of vessels near an alignment's. Standard deviations: `std` of what is constant,
    along, across, delay (3,), `late` where not estimated, and `noise_m` of the drift. `together` rows count as one."""
    residuals = start.residuals
    vessel, time_s = residuals.vessel, residuals.sightings.time_s[residuals.row]
    px, slopes = _px_and_slopes(aligner, start)
    slopes = _with_mean_speeds(aligner, start, slopes)
    own_px = slopes[:, OWN] / parameters.plausible(OF_A_VESSEL_NAMES)
    reported_px = px - (own_px * start.values.vessels[vessel]).sum(axis=1)
    axes, drift_alone = (drift_axes(time_s, vessel, spreads, noise_m) for spreads in (std, late))
    places = [PROBED.index(name) for name in free]
    drift = fit_drift(residuals, reported_px, px, slopes[:, places], own_px, axes, together)
    # All columns are scaled and weighted together, and taken apart again.
    axes_px, drifts_px, off_px = (
        (own_px[:, :, None] * metres).sum(axis=1) for metres in (axes, drift_alone, drift.off[:, :, None])
    )
    scaled = np.column_stack([slopes, axes_px, drifts_px, off_px]) / drift.spreads_px[:, None]
    linear = Linear.of_soft_loss(scaled, drift.errors_px / drift.spreads_px, SOFT)
    cuts = np.cumsum([len(PROBED), axes_px.shape[1], drifts_px.shape[1]])
    by_value, by_axis, by_drift, off = np.split(linear.slopes, cuts, axis=1)
    values = _changed(start.values, free, drift.change, vessel, drift.steady)
    moved = Alignment(values, start.sightings, residuals, start.spreads_px)
    reported = Linear(by_value, linear.residuals - off[:, 0])
    return _Round(moved, drift.change, Linear(by_value, linear.residuals), reported, by_axis, by_drift)


def _changed(
    values: parameters.Values, free: tuple[str, ...], change: Array, vessel: Indices, off: Array
) -> parameters.Values:
    """Values with a change of shared ones, in plausible distances, and each vessel off as its rows say on average."""
    shared, vessels = values.shared.copy(), np.zeros_like(values.vessels)
    shared[[parameters.PLACE[name] for name in free]] += change * parameters.plausible(free)
    counts = np.maximum(np.bincount(vessel, minlength=len(vessels)), 1)
    for axis in range(off.shape[1]):
        vessels[:, axis] = np.bincount(vessel, off[:, axis], len(vessels)) / counts
    return parameters.Values(shared, vessels)
