"""Box errors: mean, standard deviations and correlations of each state, and how long they persist."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import clip, move, sizes
from modsim3d.detector.doubles import LEAST_SPLIT_PX
from modsim3d.detector.model import ERROR_COMPONENTS, DetectorModel, PerformanceState
from modsim3d.detector.records import TRUE
from modsim3d.learn.class_checks import correlation_note
from modsim3d.learn.error_fit import (
    PAIRS,
    ErrorFit,
    ErrorSample,
    MomentTable,
    NormalLaw,
    fit_step,
    fitted_law,
    statistics,
)
from modsim3d.learn.error_replay import REPLAYS, latent_paths, own_root, products, replayed_errors
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.limits import limit_note
from modsim3d.learn.measures import Estimate, Exact
from modsim3d.learn.pairs import turn_before
from modsim3d.learn.parameters import Parameter

GROUP = "box error"
LEAST_DETECTIONS = 150
"""True detections in a state, below which its box errors are not tested."""
LEAST_WORTH = 300
"""Independent errors that errors that persist have to be worth.

They come in clumps: a few vessels that keep theirs stray farther than a law with their variance and skewness.
"""
LEAST_PAIRS = 100
_ROUNDING_PX = 1e-6
_REPLAYS_AT_ONCE = 50
_CONDITION = 1e8
_KNOWN, _LEAST_SHARE = 10.0, 1e-3


@dataclass(frozen=True, eq=False)
class Fitted:
    """A state's box errors.

    Attributes:
        law: Asked for.
        found: Fitted.
        fit: The step between them.
        sample: Of what.
        hits: Rows of the true detections, shape (n,).
    """

    law: NormalLaw
    found: NormalLaw
    fit: ErrorFit
    sample: ErrorSample
    hits: Indices


def box_error_checks(
    model: DetectorModel, evidence: Evidence, table: MomentTable, states: Collection[str] | None = None
) -> list[Parameter]:
    """The parameters of each state; the boxes themselves; correlation from frame to frame.

    Args:
        model: What was asked for.
        evidence: What the run shows.
        table: Expectations that are known already.
        states: Only these; all if None.
    """
    hits = evidence.hits
    usable = usable_hits(model, evidence)
    limited = limit_note(model, evidence)
    state_of_hits = evidence.chances.state[hits.chance]
    laws: dict[int, tuple[NormalLaw, Fitted | None]] = {}
    parameters: dict[int, list[Parameter]] = {}
    notes: dict[int, str] = {}
    chosen = [s for s, state in enumerate(model.states) if states is None or state.name in states]
    for s in chosen:
        state = model.states[s]
        rows = np.flatnonzero((state_of_hits == s) & usable)
        if limited and state.confidence.size_slope:  # of the surest, boxes that came out large are too many
            rows, notes[s] = rows[:0], limited
        if _is_singular(state):
            parameters[s] = _exact_checks(state, evidence, rows)
        else:
            laws[s] = NormalLaw.of(state), _fit(NormalLaw.of(state), evidence, rows, table)
    fits = [fitted for _, fitted in laws.values() if fitted is not None]
    replayed = _replay(model, evidence, fits) if model.persistence.box_s > 0 else None
    for s, (law, fitted) in laws.items():
        errors = None if replayed is None or fitted is None else replayed.errors[fits.index(fitted)]
        parameters[s] = _law_checks(model.states[s], law, fitted, errors)
    for s, note in notes.items():
        parameters[s] = [replace(parameter, note=note) for parameter in parameters[s]]
    persistence = _persistence(evidence, fits, model, replayed)
    return [
        *(parameter for s in chosen for parameter in parameters[s]),
        _box_check(evidence),
        Parameter("persistence.box_s", GROUP, persistence, note=correlation_note(persistence)),
    ]


def usable_hits(model: DetectorModel, evidence: Evidence) -> Mask:
    """Hits that are one box of one vessel, chosen in a way that does not depend on the error, shape (m,).

    Only boxes that come out wide enough are split, and of those that are the error is not known. Left alone the others
    would be too narrow on average, so as large a share of the narrow boxes of long vessels is left out.
    """
    hits = evidence.hits
    usable: Mask = hits.kind == TRUE
    if not model.doubles.splits:
        return usable
    truth = np.concatenate([seen.targets.boxes_px for seen in evidence.cameras])
    narrow = model.doubles.looks_long(truth[hits.chance]) & (sizes(hits.boxes_px)[:, 0] < LEAST_SPLIT_PX)
    left_out = np.random.default_rng(0).random(len(narrow)) < model.doubles.splits
    return usable & ~(narrow & left_out)


def _is_singular(state: PerformanceState) -> bool:
    covariance, std = state.box_error.covariance, state.box_error.std
    return bool((std <= 0).any() or np.linalg.cond(covariance / np.outer(std, std)) > _CONDITION)


def _fit(law: NormalLaw, evidence: Evidence, rows: Indices, table: MomentTable) -> Fitted | None:
    if len(rows) < LEAST_DETECTIONS:
        return None
    hits, chances = evidence.hits, evidence.chances
    sample = ErrorSample(hits.errors_px[rows], hits.chance[rows], chances.boxes_px, chances.image_px)
    fit = fit_step(law, sample, table)
    return None if fit is None else Fitted(law, fitted_law(law, fit, sample), fit, sample, rows)


def _names(law: NormalLaw) -> list[str]:
    names = [f"mean[{c}]" for c in ERROR_COMPONENTS] + [f"std[{c}]" for c in ERROR_COMPONENTS]
    names += [f"correlation[{ERROR_COMPONENTS[i]},{ERROR_COMPONENTS[j]}]" for i, j in PAIRS]
    return names + [f"growth[{ERROR_COMPONENTS[k]}]" for k in law.growing]


def _law_checks(
    state: PerformanceState, law: NormalLaw, fitted: Fitted | None, replayed: Array | None
) -> list[Parameter]:
    asked, parameters = law.numbers(), []
    note = "" if fitted is None else _truncation_note(fitted.fit)
    for k, entry in enumerate(_names(law)):
        measure = None if fitted is None else _estimate(fitted, k, replayed)
        few = measure is not None and replayed is not None and measure.count < LEAST_WORTH
        path = f"states.{state.name}.box_error.{entry}"
        unit = ("" if 8 <= k < 14 or k >= 14 else "sides") if law.relative else "px" if k < 8 else ""
        parameters.append(
            Parameter(
                path, GROUP, None if few else measure, float(asked[k]), unit, state.name, note=note if k == 0 else ""
            )
        )
    return parameters


def _estimate(fitted: Fitted, k: int, replayed: Array | None) -> Estimate:
    """One of the law's numbers; replays say by how much errors that persist count for fewer."""
    fit = fitted.fit
    error = fit.errors[k] if replayed is None else replayed[k]
    wider = error / fit.errors[k]
    return Estimate(
        measured=float(fitted.found.numbers()[k]),
        asked=float(fitted.law.numbers()[k]),
        error=float(error * fitted.law.units()[k]),
        count=len(fitted.hits) / max(wider, 1.0) ** 2,
        skewness=float(fit.skewness[k] * wider),
        statistic=float(fit.step[k] / error),
        grows=4 <= k < 8,
    )


def _truncation_note(fit: ErrorFit) -> str:
    share = 1 - float(fit.acceptance.mean())
    return f"{share:.0%} of first draws leave no box and are drawn anew: taken out" if share >= 0.005 else ""


def _exact_checks(state: PerformanceState, evidence: Evidence, rows: Indices) -> list[Parameter]:
    """Of a covariance without an inverse: errors that have no spread are their mean."""
    law = NormalLaw(state.box_error.mean, np.zeros(4), np.eye(4), state.box_error.relative)
    means, _ = law.at(evidence.chances.boxes_px[evidence.hits.chance[rows]])
    off = np.abs(evidence.hits.errors_px[rows] - means) > _ROUNDING_PX
    still = (state.box_error.std <= 0) & (state.box_error.growth <= 0)
    parameters = []
    for k, entry in enumerate(ERROR_COMPONENTS):
        path = f"states.{state.name}.box_error.std[{entry}]"
        measure = Exact(int(off[:, k].sum()), len(rows)) if still[k] and len(rows) else None
        note = "" if still[k] else "the covariance is singular: only errors without any spread are looked at"
        parameters.append(Parameter(path, GROUP, measure, 0.0, "px", state.name, note=note))
    return parameters


def _box_check(evidence: Evidence) -> Parameter:
    """Whether every box is its truth moved by its error and clipped to the image."""
    single = np.flatnonzero(evidence.hits.kind == TRUE)
    hits, chances = evidence.hits, evidence.chances
    rows = hits.chance[single]
    wrong = 0
    for camera, seen in enumerate(evidence.cameras):
        ours = np.flatnonzero(chances.camera[rows] == camera)
        moved = move(chances.boxes_px[rows[ours]], hits.errors_px[single[ours]])
        off = np.abs(hits.boxes_px[single[ours]] - clip(moved, seen.frames.image_size_px))
        wrong += int((off.max(axis=1, initial=0) > _ROUNDING_PX).sum())
    return Parameter("boxes are truth and error, clipped", GROUP, Exact(wrong, len(single)), in_file=False)


@dataclass(frozen=True, eq=False)
class Replayed:
    """What replays of errors that persist show.

    Attributes:
        errors: Standard errors of each state's step, shapes (p,).
        products: Mean products with the frame before, of each replay, shape (replays,).
    """

    errors: list[Array]
    products: Array


def _frame_pairs(model: DetectorModel, evidence: Evidence, fits: list[Fitted]) -> tuple[Indices, Indices]:
    """Places, in the fits' rows one after the other, of detections of one vessel, one turn of the detector apart."""
    rows = np.concatenate([fitted.hits for fitted in fits])
    chance = evidence.hits.chance[rows]
    place = np.full(len(evidence.chances.state), -1)
    place[chance] = np.arange(len(rows))
    before = turn_before(model, evidence)[chance]
    before = np.where(before >= 0, place[before], -1)
    now = np.flatnonzero(before >= 0)
    return now, before[now]


def _replay(model: DetectorModel, evidence: Evidence, fits: list[Fitted]) -> Replayed | None:
    if not fits:
        return None
    rng = np.random.default_rng(0)
    chances = evidence.chances
    chance = np.concatenate([evidence.hits.chance[fitted.hits] for fitted in fits])
    tracks = np.stack([chances.camera[chance], chances.vessel[chance]], axis=1)
    now, before = _frame_pairs(model, evidence, fits)
    ends = np.cumsum([0, *(len(fitted.hits) for fitted in fits)])
    steps: list[list[Array]] = [[] for _ in fits]
    found = []
    for _ in range(0, REPLAYS, _REPLAYS_AT_ONCE):
        latent = latent_paths(tracks, chances.time_s[chance], model.persistence.box_s, rng, _REPLAYS_AT_ONCE)
        whitened = np.empty((_REPLAYS_AT_ONCE, len(chance), 4))
        for k, fitted in enumerate(fits):
            ours = slice(ends[k], ends[k + 1])
            standard = replayed_errors(fitted.law, fitted.sample, latent[:, ours], rng)
            steps[k].append(fitted.fit.step_of(statistics(standard)))
            residual = standard - fitted.fit.expected[:, :4]
            whitened[:, ours] = np.einsum("nij,cnj->cni", fitted.fit.roots, residual, optimize=True)
        found.append(products(whitened, now, before))
    return Replayed([np.concatenate(step).std(axis=0) for step in steps], np.concatenate(found))


def _persistence(
    evidence: Evidence, fits: list[Fitted], model: DetectorModel, replayed: Replayed | None
) -> Estimate | None:
    """Correlation of latent numbers with those of the same vessel one frame before."""
    if not fits:
        return None
    now, before = _frame_pairs(model, evidence, fits)
    if len(now) < LEAST_PAIRS:
        return None
    # Means and spreads that are off would look like a correlation: they are taken out as they were found.
    whitened = np.concatenate([_own_scale(fitted.fit.whitened) for fitted in fits])
    product = float(products(whitened, now, before))
    if replayed is None:
        asked, left, error, known = 0.0, 0.0, (4 * len(now)) ** -0.5, math.inf
    else:
        chances = evidence.chances
        rows = np.concatenate([evidence.hits.chance[fitted.hits] for fitted in fits])
        apart = chances.time_s[rows[now]] - chances.time_s[rows[before]]
        asked = float(np.exp(-apart / model.persistence.box_s).mean())
        left, error = float(replayed.products.mean()), float(replayed.products.std())
        known = error / math.sqrt(len(replayed.products))
    # Of a correlation truncation leaves a part: that is what replays show, or for a small one what boxes leave of it.
    share = left / asked if abs(left) > _KNOWN * known else float(_shares_left(fits, now, before).mean())
    scale = 1 / max(share, _LEAST_SHARE)
    return Estimate(
        asked + (product - left) * scale, asked, error * scale, len(now), statistic=(product - left) / error
    )


def _shares_left(fits: list[Fitted], now: Indices, before: Indices) -> Array:
    """How much of a small correlation of latent numbers is left between whitened errors of pairs, shape (m,).

    A first draw that counts has w = R (s − E s) and s = S z with the latent numbers z; one that does not has none of
    them. So E[w zᵀ] = α R C S⁻ᵀ, where R C Rᵀ = 1; and E[w · w′] = ρ tr(E[w zᵀ] E[w′ zᵀ]ᵀ) where z and z′ are
    correlated by a small ρ.
    """
    gains = []
    for fitted in fits:
        inverse = np.linalg.inv(own_root(fitted.law))
        left = np.swapaxes(np.linalg.inv(fitted.fit.roots), 1, 2) @ inverse.T
        gains.append(fitted.fit.acceptance[:, None, None] * left)
    gain = np.concatenate(gains)
    shares: Array = np.einsum("mij,mij->m", gain[now], gain[before]) / 4
    return shares


def _own_scale(whitened: Array) -> Array:
    """With mean zero and variance one as found."""
    scaled: Array = (whitened - whitened.mean(axis=0)) / np.maximum(whitened.std(axis=0), 1e-12)
    return scaled
