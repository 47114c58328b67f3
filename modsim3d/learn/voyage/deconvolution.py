"""Learned box errors less the errors of truth, and how long they persist."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.statistics import MAD_TO_STD
from modsim3d.core.text import counted
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS
from modsim3d.learn.bootstrap import Entry, spread
from modsim3d.learn.box_errors.laws import LearnedErrors, covariance, moments
from modsim3d.learn.learned_detector import Estimates
from modsim3d.learn.matches import ErrorSource, Pairs
from modsim3d.learn.persistence import frame_interval_s, steps_between
from modsim3d.learn.report import LearnReport
from modsim3d.learn.voyage.reference_error import ReferenceErrors, ReferenceNoise, View, box_jacobians
from modsim3d.scene.scene import Scene

# ---- The covariance of box errors without that part ----

_MIN_PART = 1e-3  # a replicate whose rest is not positive keeps this share of a variance
_MAX_CORRELATION = 0.999
_ALIKE = 0.15  # by which share standard deviations as measured may differ from those of the law
_FIRST, _SECOND = (np.array(column) for column in zip(*ERROR_PAIRS, strict=True))


@dataclass(frozen=True, eq=False)
class Deconvolution:
    """Errors of one state, less those of truth; where one of e_x, e_y, e_w, e_h was not `taken_off`, an upper bound.
    `at_least` are standard deviations of what changes from frame to frame, the detector's, nan if unknown; `noise_std`
    are those by errors of truth, in the unit of the errors; `before` and `after` are means over boxes."""

    errors: LearnedErrors  # what is written
    taken_off: Mask  # (4,), as are the next
    noise_std: Array
    before: Array
    after: Array
    at_least: Array
    share: Array  # of the whitened errors that was taken off, (rows,)

    @property
    def bounds(self) -> tuple[str, ...]:
        """Names of the components that are upper bounds."""
        return tuple(name for name, taken in zip(ERROR_COMPONENTS, self.taken_off, strict=True) if not taken)


def deconvolve(
    errors: LearnedErrors, noise: Array, sides_px: Array, level: float, measured: Array, at_least: Array, cut_off: bool
) -> Deconvolution:
    """Take the covariance of errors of truth off the errors of a state, where the rest is surely positive: where its
    interval of the level does not reach 0. `noise` is the covariance in the errors' unit, estimate and replicates,
    (rows, 4, 4); `sides_px` are width, height, width and height of the boxes, (n, 4).
    The law keeps its form: of mixed errors, whose standard deviations grow with the side, both parts shrink alike.
    Correlations with a component that is an upper bound are unknown: they keep their estimate, but no replicates.
    The part is taken off the covariances `measured` of the errors themselves, (rows, 4, 4): errors of
    truth differ from box to box, so that the likeliest law has not quite their covariance. Those of components that are
    far from it, as wrong matches make them, are not used; but where they are smaller, they must surely be larger than
    errors of truth. Matching may have `cut_off` errors, which only the law knows."""
    std, correlation = np.nan_to_num(errors.std.column.values), np.nan_to_num(errors.correlation.column.values)
    growth = np.zeros_like(std) if errors.growth is None else np.maximum(errors.growth.column.values, 0)
    products = _mean_products(std, growth, sides_px)
    whole = products * _matrix(correlation)
    if not cut_off:
        whole = _as_measured(whole, measured)
    # Tails of the law may be wider than the errors.
    sure = _sure(measured, noise, level) | ~(np.diag(measured[0]) < np.diag(whole[0]))
    taken = _sure(whole, noise, level) & sure
    part = noise * (taken[:, None] & taken[None, :])
    if np.linalg.eigvalsh(whole[0] - part[0])[0] <= 0:
        taken, part = np.zeros(4, dtype=bool), np.zeros_like(part)
    factors, correlation = _shrunk(products, whole - part, correlation, taken)
    variance = np.diag(products[0])
    written = replace(
        errors,
        std=_with(errors.std, std * factors),
        correlation=_with(errors.correlation, correlation),
        growth=None if errors.growth is None else _with(errors.growth, growth * factors),
    )
    return Deconvolution(
        written,
        taken,
        np.sqrt(np.diag(noise[0])),
        np.sqrt(variance),
        np.sqrt(variance) * factors[0],
        at_least,
        np.clip(np.einsum("bij,bji->b", np.linalg.pinv(whole), part) / 4, 0, 1),
    )


def _shrunk(products: Array, rest: Array, correlation: Array, taken: Mask) -> tuple[Array, Array]:
    """Factors of a law's standard deviations, (rows, 4), and its correlations (rows, 6), less parts of components
    `taken` (4,), from means of σ_j σ_k of the law, and what is left, (rows, 4, 4) each."""
    variance = np.einsum("bii->bi", products)
    least = np.maximum(np.einsum("bii->bi", rest), _MIN_PART * variance)
    factors = np.sqrt(least / np.where(variance > 0, variance, 1.0))
    factors = np.where(taken, np.minimum(factors, 1.0), 1.0)
    scale = products * factors[:, :, None] * factors[:, None, :]
    left = rest / np.where(scale > 0, scale, 1.0)
    left = np.clip(left[:, _FIRST, _SECOND], -_MAX_CORRELATION, _MAX_CORRELATION)
    correlation = np.where(taken[_FIRST] | taken[_SECOND], left, correlation)
    correlation[1:, ~(taken[_FIRST] & taken[_SECOND])] = np.nan  # with errors of truth in it, it tells no interval
    return factors, correlation


def _as_measured(law: Array, measured: Array) -> Array:
    """Covariances of the law (rows, 4, 4) with standard deviations as measured, where both are nearly the same. A
    vessel that is elsewhere makes one component's errors far from the law, and its tails, which all share, too wide for
    the others. Where all are alike, so are correlations."""
    ratio = np.sqrt(np.einsum("bii->bi", measured) / np.maximum(np.einsum("bii->bi", law), 1e-300))
    alike = np.abs(ratio[0] - 1) <= _ALIKE
    if alike.all():
        return measured
    scale = np.where(alike, ratio, 1.0)
    return law * scale[:, :, None] * scale[:, None, :]


def _sure(whole: Array, noise: Array, level: float) -> Mask:
    """Mask of the variances that are surely larger than those that errors of truth give, shape (4,)."""
    rest = np.einsum("bii->bi", whole - noise)
    if len(rest) < 3:
        return np.zeros(4, dtype=bool)
    return np.asarray(rest[0] - float(special.ndtri((1 + level) / 2)) * spread(rest[1:]) > 0)


def _mean_products(std: Array, growth: Array, sides_px: Array) -> Array:
    """Means over boxes of σ_j σ_k with σ = std + growth · side, shape (rows, 4, 4)."""
    mean, second = sides_px.mean(axis=0), sides_px.T @ sides_px / len(sides_px)
    cross = np.einsum("bj,bk->bjk", std, growth * mean)
    products: Array = (
        np.einsum("bj,bk->bjk", std, std)
        + cross
        + np.swapaxes(cross, 1, 2)
        + np.einsum("bj,bk->bjk", growth, growth) * second
    )
    return products


def _matrix(pairs: Array) -> Array:
    """Correlation matrices (rows, 4, 4) from correlations of the `ERROR_PAIRS`, shape (rows, 6)."""
    matrix = np.tile(np.eye(4), (len(pairs), 1, 1))
    matrix[:, _FIRST, _SECOND] = matrix[:, _SECOND, _FIRST] = pairs
    return matrix


def _with(entry: Entry, values: Array) -> Entry:
    return replace(entry, column=replace(entry.column, values=values))


# ---- How long the detector's errors persist ----

_MIN_CORRELATION = 0.01  # from one frame to the next, that a replicate keeps: frames do not tell less from none


def share_left(entry: Entry, part: Array) -> Entry:
    """The share of errors that vessels keep, less a part (rows,) of all errors that is kept for ever."""
    return _with(entry, np.maximum((entry.column.values - part) / (1 - part), 0))


def time_left(entry: Entry, part: Array, gap_s: float) -> Entry:
    """The correlation time of errors, less a part (rows,) of all errors that is kept for ever. It was learned from
    frames that follow each other, so their correlation is what must come out."""
    left = np.clip((np.exp(-gap_s / np.maximum(entry.column.values, 1e-9)) - part) / (1 - part), 0, 1)
    left[1:] = np.maximum(left[1:], _MIN_CORRELATION)
    time_s = np.where(left > 0, gap_s / -np.log(np.clip(left, 1e-12, 1 - 1e-12)), 0.0)
    return _with(entry, np.where(part > 0, time_s, entry.column.values))


_MAX_FRAMES = 500  # frames that errors of truth are drawn in: they change over minutes
_MIN_PAIRS = 10
_MAX_LOST = 0.02  # where matching cuts off more boxes than this for each match, errors as measured are too small
_SLOW = 5.0  # errors of truth last for ever, compared with those of the detector, if they last so many times as long


@dataclass(frozen=True)
class ComponentNoise:
    """Errors of one component of boxes in one state."""

    state: str
    component: str  # `x`, `y`, `width` or `height`
    unit: str  # `px`, or `of the side`
    std: tuple[float, ...]  # as learned, from errors of truth, at least, and as written; nan where unknown
    upper_bound: bool  # where errors of truth were not taken off


@dataclass(frozen=True, eq=False)
class CorrectedDetector:
    """A detector of which the errors of truth are taken off. Where these last far longer than those of the detector,
    they are `slow`, and are taken off what persists as well."""

    learned: Estimates  # what is written
    states: tuple[Deconvolution | None, ...]  # None where too few boxes tell the errors of truth
    noise: ReferenceNoise
    moved: int  # number of vessels whose places registration has found
    slow: bool

    def sentences(self) -> Iterator[str]:
        """Sentences on assumptions and upper bounds."""
        noise = self.noise
        if not noise.std.any():
            yield "errors of truth: none are assumed"
            return
        uncertain = "".join(f", {name} of {count} vessel{'s' * (count > 1)}" for name, count in noise.reasons.items())
        less = f"; less what registration found of {counted(self.moved, 'vessel')}" if self.moved else ""
        positions = f"positions to {noise.position_m:g} m in each direction, for {noise.position_s:g} s"
        yield f"errors of truth: {positions}{uncertain}{less}"
        for name, state in zip(self.learned.observed.states, self.states, strict=True):
            where = f"states.{name}.box_error.covariance"
            if state is None:
                yield f"{where}: an upper bound; too few matches tell how errors of truth show in it"
            elif state.bounds:
                which = "x, y, width and height" if len(state.bounds) == 4 else ", ".join(state.bounds)
                yield (
                    f"{where}: an upper bound in {which}, for it is not surely larger than what errors of truth give; "
                    "correlations with it are unknown"
                )
        yield from self._on_persistence()

    def _on_persistence(self) -> Iterator[str]:
        errors = self.learned.numbers.box_errors
        if errors.box_s is None or not self.noise.std.any():
            return
        key = "box_s" if errors.box_vessel_share is None else "box_vessel_share"
        if self.slow:
            but = " (but for the components that are upper bounds)" if any(s and s.bounds for s in self.states) else ""
            yield f"persistence.{key}: less what persists of errors of truth{but}, as if they lasted for ever"
        else:
            yield f"persistence.{key}: an upper bound; errors of truth persist for about as long"

    def components(self) -> Iterator[ComponentNoise]:
        """The errors of each state and component of boxes."""
        for name, state in zip(self.learned.observed.states, self.states, strict=True):
            if state is None:
                continue
            unit = "px" if state.errors.unit != "relative" else "of the side"
            columns = np.stack([state.before, state.noise_std, state.at_least, state.after])
            for k, component in enumerate(("x", "y", "width", "height")):
                yield ComponentNoise(name, component, unit, tuple(columns[:, k].tolist()), not state.taken_off[k])

    def rows(self) -> list[tuple[str, ...]]:
        """A row of `HEADER` for each state and component."""
        return [
            (
                *(row.state, row.component, row.unit),
                *("–" if np.isnan(std) else f"{std:.3g}" for std in row.std),
                "upper bound" if row.upper_bound else "",
            )
            for row in self.components()
        ]


TITLE = "Standard deviations of box errors, with and without errors of truth"
HEADER = ("state", "error of", "unit", "learned", "from errors of truth", "at least", "written", "")


def subtract_reference_error(
    learned: Estimates, scene: Scene, views: Sequence[View], noise: ReferenceNoise, level: float = 0.95, seed: int = 0
) -> CorrectedDetector:
    """Take errors of truth off the learned box errors, where what is left is surely positive: where its interval of the
    level does not reach 0. The identities of the learned annotations are indices of the scene's vessels, see `View`;
    `seed` is that of the draws of errors of truth."""
    box_errors, rows = learned.numbers.box_errors, len(learned.resampling.weights)
    if not noise.std.any():
        return CorrectedDetector(learned, (None,) * len(box_errors.states), noise, 0, False)
    jacobians = _Jacobians.of(learned, scene, views)
    numbers = range(len(box_errors.states))
    states = [_deconvolved_state(learned, index, jacobians, noise, level, seed + index) for index in numbers]
    box_s, share = box_errors.box_s, box_errors.box_vessel_share
    slow = box_s is not None and float(box_s.estimate) * _SLOW <= noise.position_s
    if slow and box_s is not None:
        part = _part_of_truth(states, learned.observed.pairs, rows)
        if share is not None:
            share = share_left(share, part)
        else:
            box_s = time_left(box_s, part, frame_interval_s(learned.observed.labelled))
    errors = tuple(old if new is None else new.errors for old, new in zip(box_errors.states, states, strict=True))
    box_errors = replace(box_errors, states=errors, box_s=box_s, box_vessel_share=share)
    written = replace(learned, numbers=replace(learned.numbers, box_errors=box_errors))
    moved = len(np.unique(jacobians.vessel[jacobians.moved >= 0]))
    return CorrectedDetector(written, tuple(states), noise, moved, slow)


def _deconvolved_state(
    learned: Estimates, index: int, jacobians: _Jacobians, noise: ReferenceNoise, level: float, seed: int
) -> Deconvolution | None:
    """Errors of a state less those of truth; None where too few boxes tell these. See `subtract_reference_error`."""
    box_errors, pairs = learned.numbers.box_errors, learned.observed.pairs
    errors, source = box_errors.states[index], learned.form.box_errors.states[index].source
    chosen = pairs.edges.whole if source is not ErrorSource.ALL_PAIRS else pairs.sure
    if source is ErrorSource.OWN_STATE:
        chosen = chosen & (pairs.state == index)
    relative, replicates = errors.unit == "relative", len(learned.resampling.weights) - 1
    of_truth = jacobians.errors(pairs, chosen, relative, noise)
    if of_truth is None or replicates < 1:
        return None
    drawn = of_truth.covariances(replicates, seed)
    covariances = np.concatenate([drawn.mean(axis=0, keepdims=True), drawn])
    measured = _measured(learned, chosen, relative)
    at_least = _changes(learned, chosen, relative, of_truth.change, noise.position_s)
    cut_off = box_errors.used[index].lost > _MAX_LOST
    return deconvolve(errors, covariances, pairs.sides_px[chosen], level, measured, at_least, cut_off)


def corrected_report(
    report: LearnReport, scene: Scene, views: Sequence[View], noise: ReferenceNoise
) -> tuple[LearnReport, CorrectedDetector]:
    """Report with learned numbers without errors of truth, and with remarks that say so."""
    detector = subtract_reference_error(report.learned, scene, views, noise, report.level)
    remarks = (*report.remarks_on_data, *detector.sentences())
    return replace(report, learned=detector.learned, remarks_on_data=remarks), detector


@dataclass(frozen=True, eq=False)
class _Jacobians:
    """Derivatives of boxes (n, 4, 8), times, vessels, fits (n,) of pairs at `place` (n,); see `ReferenceErrors`."""

    place: Indices
    jacobians: Array
    time_s: Array
    vessel: Indices
    moved: Indices

    @classmethod
    def of(cls, learned: Estimates, scene: Scene, views: Sequence[View]) -> _Jacobians:
        """Jacobians of pairs in at most so many images of each camera."""
        pairs, labelled = learned.observed.pairs, learned.observed.labelled
        identity, vessel = labelled.annotations.identity[pairs.rows], np.full(len(pairs), -1)
        moved = np.full(len(pairs), -1)
        places, blocks = [np.empty(0, dtype=np.int64)], [np.empty((0, 4, 8))]
        for number, view in enumerate(views):
            some = np.unique(np.linspace(0, len(view.images) - 1, _MAX_FRAMES).round().astype(np.int64))
            frame = np.full(len(labelled.images), -1)
            frame[view.images[some]] = some
            place = np.flatnonzero((frame[pairs.image] >= 0) & (identity >= 0))
            if not len(place):
                continue
            vessel[place] = identity[place] - view.first_identity
            if view.moved is not None:
                moved[place] = np.where(view.moved[vessel[place]], number * len(scene.vessels) + vessel[place], -1)
            jacobians = box_jacobians(scene, view, frame[pairs.image[place]], vessel[place])
            finite = np.isfinite(jacobians).all(axis=(1, 2))
            places.append(place[finite])
            blocks.append(jacobians[finite])
        place = np.concatenate(places)
        time_s = labelled.images.time_s[pairs.image[place]]
        return cls(place, np.concatenate(blocks), time_s, vessel[place], moved[place])

    def errors(self, pairs: Pairs, chosen: Mask, relative: bool, noise: ReferenceNoise) -> ReferenceErrors | None:
        """Errors of truth of some pairs; None of too few."""
        subset = chosen[self.place]
        if subset.sum() < _MIN_PAIRS:
            return None
        unit_px = pairs.sides_px[self.place[subset]] if relative else np.ones((int(subset.sum()), 4))
        columns = self.jacobians[subset], self.time_s[subset], self.vessel[subset]
        return ReferenceErrors(*columns, noise, unit_px, self.moved[subset])


def _measured(learned: Estimates, subset: Mask, relative: bool) -> Array:
    """Covariances of the errors of some pairs (m,) in each replicate, shape (rows, 4, 4)."""
    pairs = learned.observed.pairs
    _, std, correlation = moments(learned.resampling, pairs.image[subset], pairs.errors(subset, relative))
    return np.stack([covariance(*row) for row in zip(np.nan_to_num(std), np.nan_to_num(correlation), strict=True)])


def _changes(learned: Estimates, subset: Mask, relative: bool, noise: Array, lasting_s: float) -> Array:
    """Standard deviations of errors' changes to the next frame less those of truth, given variances (4,), or NaN."""
    pairs, place = learned.observed.pairs, np.flatnonzero(subset)
    steps = steps_between(learned.observed.labelled, pairs.rows[place])
    if len(steps) < _MIN_PAIRS:
        return np.full(4, np.nan)
    errors = pairs.errors(subset, relative)
    apart = np.abs(errors[steps.later] - errors[steps.earlier])
    change = (MAD_TO_STD * np.median(apart, axis=0)) ** 2 / 2  # a wrong match must not pull
    return np.asarray(np.sqrt(np.maximum(change - noise * -np.expm1(-steps.apart_s / lasting_s).mean(), 0)))


def _part_of_truth(states: Sequence[Deconvolution | None], pairs: Pairs, rows: int) -> Array:
    """Share of the whitened errors of all states that was taken off, shape (rows,)."""
    counts = np.bincount(pairs.state, minlength=len(states)).astype(np.float64)
    parts = np.stack([np.zeros(rows) if state is None else state.share for state in states])
    return np.asarray(np.clip(counts @ parts / max(counts.sum(), 1.0), 0, 1 - 1e-6))
