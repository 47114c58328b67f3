"""Box errors: mean, standard deviations and correlations of each state, and how long they persist."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import clip, inside_image, move, sizes
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.chain import DetectorPart, model_name
from modsim3d.detector.draws import ERROR_DISTRIBUTIONS, ERROR_NORMALS, standardised
from modsim3d.detector.merges_and_splits import MIN_SPLIT_PX
from modsim3d.detector.model import ERROR_COMPONENTS, DetectorModel, PerformanceState
from modsim3d.detector.persistence import Persistence, with_share
from modsim3d.detector.records import TRUE
from modsim3d.verify.class_checks import LAGS, correlation_note, turn_pairs
from modsim3d.verify.error_fit import MomentTable, StateErrors, StateFit, fit_step, fitted_law
from modsim3d.verify.error_parameters import LIKELIHOODS, PLAIN, ErrorParameters
from modsim3d.verify.evidence import Evidence, unknown_rest_note
from modsim3d.verify.measures import AMOUNT, ANY, CORRELATION, Estimate, Exact
from modsim3d.verify.parameters import Parameter

MIN_PAIRS = 100
_REPLAYS, _REPLAYS_AT_ONCE = 300, 50
_MAX_DRAWS = 2000
_KNOWN, _MIN_SHARE, _MAX_SCALE = 10.0, 1e-3, 10.0


@dataclass(frozen=True, eq=False)
class ReplayedErrors:
    """Statistics of many replays of the same detections' errors."""

    errors: list[Array]  # standard errors of each state's step, shapes (p,)
    products: Array  # mean product of whitened errors with those one frame before, in each replay, shape (replays,)
    lagged: Array  # that of each component with those `LAGS` frames before, shape (replays, lags, 4)


def replay(model: DetectorModel, evidence: Evidence, fits: list[StateFit]) -> ReplayedErrors | None:
    """Draw persistent errors of the same detections many times; None if there are none."""
    if not fits:
        return None
    rng = np.random.default_rng(0)
    tracks, times_s = evidence.instances.tracks(_instances_of(evidence, fits))
    now, before = turn_pairs(model, evidence, _instances_of(evidence, fits))
    ends = np.cumsum([0, *(len(fit.rows) for fit in fits)])
    steps: list[list[Array]] = [[] for _ in fits]
    products, lagged = [], []
    lags = _lagged_pairs(tracks, times_s) if model.persistence.box is not None else []
    width = ERROR_NORMALS + max(fit.law.distribution.extra_normals for fit in fits)
    for _ in range(0, _REPLAYS, _REPLAYS_AT_ONCE):
        latent = latent_paths(tracks, times_s, model.persistence, rng, _REPLAYS_AT_ONCE, width)
        whitened = np.empty((_REPLAYS_AT_ONCE, len(times_s), 4))
        for k, fit in enumerate(fits):
            span = slice(ends[k], ends[k + 1])
            statistics = fit.law.statistics(replayed_errors(fit.law, fit.sample, latent[:, span], rng))
            steps[k].append(fit.step.step_of(statistics))
            residual = statistics[..., :4] - fit.step.expected[:, :4]
            whitened[:, span] = np.einsum("nij,cnj->cni", fit.step.roots, residual, optimize=True)
        products.append(_products(whitened, now, before))
        lagged.append(_lagged_products(whitened, lags))
    errors = [np.concatenate(step).std(axis=0) for step in steps]
    return ReplayedErrors(errors, np.concatenate(products), np.concatenate(lagged))


def _lagged_pairs(tracks: Indices, times_s: Array) -> list[tuple[Indices, Indices]]:
    """Rows of one track so many of its frames apart, later and earlier, for each of `LAGS`."""
    order = np.lexsort((times_s, *tracks.T[::-1]))
    same = tracks[order]
    pairs = []
    for lag in LAGS:
        near = np.flatnonzero((same[lag:] == same[:-lag]).all(axis=1))
        pairs.append((order[near + lag], order[near]))
    return pairs


def _lagged_products(whitened: Array, lags: list[tuple[Indices, Indices]]) -> Array:
    """Mean products of each component of whitened errors (..., n, 4) at each lag, shape (..., lags, 4)."""
    none = np.zeros((*whitened.shape[:-2], 4))
    if not lags:
        return np.zeros((*whitened.shape[:-2], 0, 4))
    products = [
        (whitened[..., later, :] * whitened[..., earlier, :]).mean(axis=-2) if len(later) else none
        for later, earlier in lags
    ]
    return np.stack(products, axis=-2)


def memory_checks(
    model: DetectorModel, evidence: Evidence, fits: list[StateFit], replayed: ReplayedErrors | None
) -> list[Parameter]:
    """Correlation of each component of box errors some frames apart, where each has a memory of its own."""
    memory = model.persistence.box
    if memory is None:
        return []
    parameters = []
    rows = _instances_of(evidence, fits) if fits else np.empty(0, dtype=np.int64)
    tracks, times_s = evidence.instances.tracks(rows)
    pairs = _lagged_pairs(tracks, times_s)
    whitened = np.concatenate([_own_scale(fit.step.whitened) for fit in fits]) if fits else np.empty((0, 4))
    products = _lagged_products(whitened, pairs)
    for k, (lag, (later, earlier)) in enumerate(zip(LAGS, pairs, strict=True)):
        for j, component in enumerate(ERROR_COMPONENTS):
            measure = None
            if replayed is not None and len(later) >= MIN_PAIRS:
                asked = float(memory.correlation(times_s[later] - times_s[earlier])[:, j].mean())
                replays = replayed.lagged[:, k, j]
                left, error = float(replays.mean()), float(replays.std(ddof=1))
                scale = min(max(asked / left if left > _KNOWN * error / len(replays) ** 0.5 else 1.0, 1.0), _MAX_SCALE)
                off = float(products[k, j]) - left
                skewness = float(((replays - left) ** 3).mean()) / error**3
                numbers = asked + scale * off, asked, scale * error
                measure = Estimate(*numbers, len(later), skewness, statistic=off / error, possible=CORRELATION)
            apart = f"{lag} {'frame' if lag == 1 else 'frames'} apart"
            name = f"persistence.box: correlation of {component}, {apart}"
            parameters.append(Parameter(name, DetectorPart.BOX_ERROR, measure, in_file=False))
    return parameters


def box_persistence(
    model: DetectorModel, evidence: Evidence, fits: list[StateFit], replayed: ReplayedErrors | None
) -> Estimate | None:
    """Correlation of latent numbers with those of the same vessel one frame before."""
    if not fits:
        return None
    now, before = turn_pairs(model, evidence, _instances_of(evidence, fits))
    if len(now) < MIN_PAIRS:
        return None
    # A wrong mean or spread would look like a correlation, so the sample's own are removed.
    product = float(_products(np.concatenate([_own_scale(fit.step.whitened) for fit in fits]), now, before))
    if replayed is None:
        asked, left, error, left_error = 0.0, 0.0, (4 * len(now)) ** -0.5, math.inf
    else:
        times_s = evidence.instances.time_s[_instances_of(evidence, fits)]
        asked = _mean_correlation(model.persistence, times_s[now] - times_s[before])
        left, error = float(replayed.products.mean()), float(replayed.products.std())
        left_error = error / math.sqrt(len(replayed.products))
    # Truncation leaves part of a correlation: replays show which, or the boxes do where the correlation is small.
    share = left / asked if abs(left) > _KNOWN * left_error else float(_shares_left(fits, now, before).mean())
    scale = 1 / max(share, _MIN_SHARE)
    off = product - left
    return Estimate(asked + off * scale, asked, error * scale, len(now), statistic=off / error, possible=CORRELATION)


def _mean_correlation(persistence: Persistence, apart_s: Array) -> float:
    """Mean correlation of the numbers behind the four components so far apart in time."""
    if persistence.box is not None:
        return float(persistence.box.correlation(apart_s)[..., :ERROR_NORMALS].mean())
    share = persistence.box_vessel_share
    return share + (1 - share) * float(_correlation_left(apart_s, persistence.box_s).mean())


def _instances_of(evidence: Evidence, fits: list[StateFit]) -> Indices:
    """Row of `Instances` of each error of all fits, one fit after the other, shape (n,)."""
    return np.asarray(evidence.true_detections.instance[np.concatenate([fit.rows for fit in fits])])


def _products(whitened: Array, now: Indices, before: Indices) -> Array:
    """Mean product of whitened errors with those one frame before, shape (...,); 0 if there are no pairs."""
    if not len(now):
        return np.zeros(whitened.shape[:-2])
    return np.asarray((whitened[..., now, :] * whitened[..., before, :]).mean(axis=(-2, -1)))


def _shares_left(fits: list[StateFit], now: Indices, before: Indices) -> Array:
    """Share of a small correlation of latent numbers that is left between whitened errors of pairs, shape (m,). A first
    draw that counts has w = R (s − E s) and s = S z with the latent numbers z; a resampled one does not depend on them.
    So E[w zᵀ] = α R C S⁻ᵀ, where R C Rᵀ = 1, times the distribution's `latent_share`; and E[w · w′] = ρ tr(E[w zᵀ]
    E[w′ zᵀ]ᵀ) where z and z′ are correlated by a small ρ."""
    gains = []
    for fit in fits:
        left = np.swapaxes(np.linalg.inv(fit.step.roots), 1, 2) @ np.linalg.inv(_root(fit.law)).T
        share = fit.law.likelihood.latent_share(fit.law.distribution)
        gains.append(share * fit.step.acceptance[:, None, None] * left)
    gain = np.concatenate(gains)
    return np.asarray(np.einsum("mij,mij->m", gain[now], gain[before]) / 4)


def _own_scale(whitened: Array) -> Array:
    """Scaled to have sample mean zero and sample variance one, shape (n, 4)."""
    return np.asarray((whitened - whitened.mean(axis=0)) / np.maximum(whitened.std(axis=0), 1e-12))


def latent_paths(
    tracks: Indices, times_s: Array, persistence: Persistence, rng: np.random.Generator, count: int, width: int
) -> Array:
    """Standard normal numbers that persist along tracks, for `count` replays of n rows, shape (count, n, width). Rows
    (n, k) of `tracks` are equal in one track, which keeps its share; times have shape (n,)."""
    order = np.lexsort((times_s, *tracks.T[::-1]))
    starts = np.append(True, (tracks[order][1:] != tracks[order][:-1]).any(axis=1))
    apart = np.diff(times_s[order], prepend=0.0)

    def walked(time_s: float) -> Array:
        kept = np.where(starts, 0.0, _correlation_left(np.maximum(apart, 0), time_s))
        walk = rng.standard_normal((len(order), count, width))
        for i in np.flatnonzero(kept > 0).tolist():
            walk[i] = kept[i] * walk[i - 1] + np.sqrt(1 - kept[i] ** 2) * walk[i]
        return walk

    memory = persistence.box
    if memory is not None:
        paths = np.sqrt(memory.white_share[:width]) * rng.standard_normal((len(order), count, width))
        own = rng.standard_normal((int(starts.sum()), count, width))[np.cumsum(starts) - 1]
        paths += np.sqrt(memory.vessel_share[:width]) * own
        for shares, time_s in zip(memory.shares, memory.times_s.tolist(), strict=True):
            paths += np.sqrt(shares[:width]) * walked(time_s)
    else:
        paths = walked(persistence.box_s)
        if persistence.box_vessel_share:
            own = rng.standard_normal((int(starts.sum()), count, ERROR_NORMALS))[np.cumsum(starts) - 1]
            paths[..., :ERROR_NORMALS] = with_share(persistence.box_vessel_share, own, paths[..., :ERROR_NORMALS])
    result = np.empty_like(paths)
    result[order] = paths
    return np.swapaxes(result, 0, 1)


def _correlation_left(apart_s: Array, correlation_s: float) -> Array:
    """Correlation that is left after some time, shape of the times; 0 where noise does not persist."""
    return np.exp(-apart_s / correlation_s) if correlation_s > 0 else np.zeros(np.shape(apart_s))


def replayed_errors(law: ErrorParameters, sample: StateErrors, latent: Array, rng: np.random.Generator) -> Array:
    """Errors in the law's standard deviations, shape (count, n, 4), of a sample's boxes from latent numbers."""
    boxes, images = sample.boxes_px[sample.rows], sample.images_px[sample.rows]
    means, stds = law.at(boxes)
    root = _root(law)
    standard = standardised(law.distribution, latent) @ root.T
    bad = np.nonzero(~inside_image(move(boxes, means + stds * standard), images))
    for _ in range(_MAX_DRAWS):
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
    return symmetric_root(law.correlation * np.outer(law.std, law.std)) / law.std[:, None]


MIN_DETECTIONS = 150  # box errors of a state with fewer true detections are not tested
MIN_WORTH = 300
"""Persistent errors are tested where they are worth so many independent ones. They come in clumps: a few vessels that
keep theirs stray farther than a law with their variance and skewness."""
MAX_SHAPE_ERROR = 1.0  # a number of the distribution itself is tested up to this standard error, in its own units
_ROUNDING_PX = 1e-6
_CONDITION = 1e8


StateFits = Mapping[int, StateFit | None]  # the fit of each state with a check of its law, None of too few boxes


def state_fits(
    model: DetectorModel, evidence: Evidence, table: MomentTable, states: Collection[str] | None = None
) -> StateFits:
    """Fit the box errors of each of the named states, or of all; the table holds expectations that are known."""
    chosen = [s for s, state in enumerate(model.states) if states is None or state.name in states]
    return {
        s: _fit(model.states[s], evidence, _rows(model, evidence, s), table)
        for s in chosen
        if model_name(ERROR_DISTRIBUTIONS, model.states[s].box_error.distribution) in LIKELIHOODS
    }


def box_error_checks(
    model: DetectorModel, evidence: Evidence, table: MomentTable, states: Collection[str] | None = None
) -> list[Parameter]:
    """The checks of the named states' fits, or of all."""
    return fit_checks(model, evidence, state_fits(model, evidence, table, states))


def fit_checks(model: DetectorModel, evidence: Evidence, fits: StateFits) -> list[Parameter]:
    """The parameters of each state that was fitted; the boxes themselves; correlation from frame to frame."""
    fit_list = [fit for fit in fits.values() if fit is not None]
    replayed = replay(model, evidence, fit_list) if model.persistence.box_memory_s > 0 else None
    parameters = []
    for s, fit in fits.items():
        errors = None if replayed is None or fit is None else replayed.errors[fit_list.index(fit)]
        parameters += [
            replace(parameter, note=_limited(model, evidence, s) or parameter.note)
            for parameter in _state_checks(model.states[s], evidence, _rows(model, evidence, s), fit, errors)
        ]
    persistence = box_persistence(model, evidence, fit_list, replayed)
    key = "persistence.box_s" if model.persistence.box is None else "persistence.box: correlation, 1 frame apart"
    return [
        *parameters,
        _box_check(evidence),
        Parameter(key, DetectorPart.BOX_ERROR, persistence, note=correlation_note(persistence)),
        *memory_checks(model, evidence, fit_list, replayed),
    ]


def _rows(model: DetectorModel, evidence: Evidence, s: int) -> Indices:
    if _limited(model, evidence, s):
        return np.empty(0, dtype=np.int64)
    of_state = evidence.instances.state[evidence.true_detections.instance] == s
    return np.flatnonzero(of_state & with_known_errors(model, evidence))


def _limited(model: DetectorModel, evidence: Evidence, s: int) -> str:
    """Reason why a state cannot be tested: too many of the most confident detections have boxes that came out large."""
    return unknown_rest_note(model, evidence) if model.states[s].confidence.size_slope else ""


def with_known_errors(model: DetectorModel, evidence: Evidence) -> Mask:
    """True detections that are one box of one vessel, chosen independently of their errors, shape (m,). Only boxes that
    come out wide enough are split, and the errors of split boxes are not known. The others alone would be too narrow on
    average, so as large a share of the narrow boxes of long vessels is left out."""
    hits, rule = evidence.true_detections, model.merges_and_splits
    usable: Mask = hits.kind == TRUE
    if not rule.splits:
        return usable
    truth = np.concatenate([seen.targets.boxes_px for seen in evidence.cameras])
    narrow = rule.looks_long(truth[hits.instance]) & (sizes(hits.boxes_px)[:, 0] < MIN_SPLIT_PX)
    return usable & ~(narrow & (np.random.default_rng(0).random(len(narrow)) < rule.splits))


def _is_singular(state: PerformanceState) -> bool:
    covariance, std = state.box_error.covariance, state.box_error.std
    return bool((std <= 0).any() or np.linalg.cond(covariance / np.outer(std, std)) > _CONDITION)


def _fit(state: PerformanceState, evidence: Evidence, rows: Indices, table: MomentTable) -> StateFit | None:
    if len(rows) < MIN_DETECTIONS or _is_singular(state):
        return None
    law, hits, instances = ErrorParameters.of(state.box_error), evidence.true_detections, evidence.instances
    sample = StateErrors(hits.errors_px[rows], hits.instance[rows], instances.boxes_px, instances.image_px)
    step = fit_step(law, sample, table)
    return None if step is None else StateFit(law, fitted_law(law, step, sample), step, sample, rows)


def _state_checks(
    state: PerformanceState, evidence: Evidence, rows: Indices, fit: StateFit | None, replayed: Array | None
) -> list[Parameter]:
    """The parameters of a state's law; where errors persist, `replayed` are their standard errors, shape (p,)."""
    if _is_singular(state):
        return _exact_checks(state, evidence, rows)
    law = ErrorParameters.of(state.box_error)
    redrawn = 0.0 if fit is None else 1 - float(fit.step.acceptance.mean())
    note = (
        f"{100 * redrawn:.0f} % of first draws leave no box and are drawn anew: taken out" if redrawn >= 0.005 else ""
    )
    parameters = []
    for k, (name, asked) in enumerate(zip(law.names(), law.numbers(), strict=True)):
        measure = None if fit is None else _estimate(fit, k, replayed)
        few = measure is not None and replayed is not None and measure.count < MIN_WORTH
        few |= fit is not None and name in law.likelihood.shape_names and fit.step.errors[k] > MAX_SHAPE_ERROR
        path, unit = f"states.{state.name}.box_error.{name}", "" if k >= 8 else "sides" if law.relative else "px"
        measure = None if few else measure
        parameters.append(Parameter(path, DetectorPart.BOX_ERROR, measure, float(asked), unit, state.name))
    return [replace(parameters[0], note=note), *parameters[1:]]


def _estimate(fit: StateFit, k: int, replayed: Array | None) -> Estimate:
    """One of the law's numbers; replays say how many independent errors persistent ones are worth."""
    step = fit.step
    error = step.errors[k] if replayed is None else replayed[k]
    wider = error / step.errors[k]
    return Estimate(
        measured=float(fit.found.numbers()[k]),
        asked=float(fit.law.numbers()[k]),
        error=float(error * fit.law.units()[k]),
        count=len(fit.rows) / max(wider, 1.0) ** 2,
        skewness=float(step.skewness[k] * wider),
        statistic=float(step.step[k] / error),
        grows=4 <= k < 8,
        possible=AMOUNT if 4 <= k < 8 else CORRELATION if 8 <= k < PLAIN else ANY,
    )


def _exact_checks(state: PerformanceState, evidence: Evidence, rows: Indices) -> list[Parameter]:
    """Checks of a singular covariance: errors without spread must be their mean."""
    law = ErrorParameters(state.box_error.mean, np.zeros(4), np.eye(4), state.box_error.relative)
    hits = evidence.true_detections
    means, _ = law.at(evidence.instances.boxes_px[hits.instance[rows]])
    off = np.abs(hits.errors_px[rows] - means) > _ROUNDING_PX
    still = (state.box_error.std <= 0) & (state.box_error.growth <= 0)
    parameters = []
    for k, entry in enumerate(ERROR_COMPONENTS):
        path = f"states.{state.name}.box_error.std[{entry}]"
        measure = Exact(int(off[:, k].sum()), len(rows)) if still[k] and len(rows) else None
        note = "" if still[k] else "the covariance is singular: only errors without any spread are looked at"
        parameters.append(Parameter(path, DetectorPart.BOX_ERROR, measure, 0.0, "px", state.name, note=note))
    return parameters


def _box_check(evidence: Evidence) -> Parameter:
    hits, instances = evidence.true_detections, evidence.instances
    single = np.flatnonzero(hits.kind == TRUE)
    rows = hits.instance[single]
    moved = move(instances.boxes_px[rows], hits.errors_px[single])
    off = np.abs(hits.boxes_px[single] - clip(moved, instances.image_px[rows]))
    wrong = Exact(int((off.max(axis=1, initial=0) > _ROUNDING_PX).sum()), len(single))
    return Parameter("boxes are truth and error, clipped", DetectorPart.BOX_ERROR, wrong, in_file=False)
