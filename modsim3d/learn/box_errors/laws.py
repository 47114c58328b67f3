"""The numbers of a distribution of box errors as a detector file has them, with their replicates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.detector.file.schema import covariance_problems
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS
from modsim3d.learn import bootstrap
from modsim3d.learn.box_errors import matched_edges
from modsim3d.learn.box_errors.fit import ErrorFit, gain_beside_strays
from modsim3d.learn.matches import ErrorFits

# ---- Which kind of distribution the box errors of a state speak for ----

T_NEEDED = MIXED_NEEDED = 100  # errors of a state that a choice between distributions needs
_GROWTHS, _GROWTHS_SIGNIFICANT = 4, 18.5
"""Numbers that mixed errors have more, and what chi-square of so many exceeds once in a thousand times."""
_MAX_ALIKE, _ALIKE = 1.1, 0.1


def excess(kept: float) -> float:
    """Variance of a sum of numbers of which a share is kept from one to the next, over that of independent ones."""
    return (1 + kept) / (1 - kept)


@dataclass(frozen=True)
class ChosenLaw:
    """A kind of distribution, with what speaks for it where it is not the plainest."""

    unit: matched_edges.Unit
    law: str = "normal"
    reasons: tuple[str, ...] = ()

    @property
    def heavy(self) -> bool:
        """Whether it is Student's t."""
        return self.law == "student_t"


def plain_unit(fits: ErrorFits, without: frozenset[str]) -> matched_edges.Unit:
    """Pixels or sides of the box, whichever makes normal errors likelier."""
    if "relative" in without:
        return "px"
    in_px, in_sides = fits.fit("px"), fits.fit("relative")
    if in_px is None or in_sides is None:
        return "relative" if _rough_value(fits, True) > _rough_value(fits, False) else "px"
    if in_sides.settled != in_px.settled:
        return "relative" if in_sides.settled else "px"
    return "relative" if in_sides.value > in_px.value + _ALIKE else "px"  # boxes of one size tell no difference


def choose_law(fits: ErrorFits, kept: float, without: frozenset[str]) -> ChosenLaw:
    """The kind of distribution that the errors clearly speak for, given their correlation from frame to frame. Twice
    the gain in log-likelihood, over the number of errors that count as one because they persist, must pass the Bayesian
    information criterion and `SIGNIFICANT`. Heavy tails follow fourth powers of the errors, growth squares."""
    unit = plain_unit(fits, without)
    chosen = ChosenLaw(unit)
    if "student_t" not in without:
        best = -np.inf
        for candidate in (unit,) if "relative" in without else (unit, _other(unit)):
            reason = heavy_tails(fits, candidate, kept, unit)
            if reason and fits.value(candidate, heavy=True) > best:
                best, chosen = fits.value(candidate, heavy=True), ChosenLaw(candidate, "student_t", (reason,))
    if "mixed" not in without and len(fits.edges) >= MIXED_NEEDED and _sides_differ(fits.edges):
        chosen = _with_growth(fits, chosen, kept, without)
    return chosen


def _other(unit: matched_edges.Unit) -> matched_edges.Unit:
    return "px" if unit == "relative" else "relative"


def heavy_tails(fits: ErrorFits, unit: matched_edges.Unit, kept: float, plain: matched_edges.Unit | None = None) -> str:
    """Reason why Student's t describes errors in a unit better than normal ones in the plain one; empty if not."""
    if not _heavy_possible(fits, unit == "relative"):
        return ""
    plain = plain or unit
    normal, alike = fits.value(plain), excess(kept**4)
    fits.value(unit, heavy=True, least=normal + alike * _needed_of_tails(len(fits.edges), alike))
    return _tails(fits, unit, plain, kept)


def _tails(fits: ErrorFits, unit: matched_edges.Unit, plain: matched_edges.Unit, kept: float) -> str:
    """Reason why tails are heavy, where Student's t has been fitted; its gain must be enough beside strays, too."""
    heavy, normal = fits.fit(unit, heavy=True), _likeliest_normal(fits, plain)
    if heavy is None or normal is None or not heavy.settled:
        return ""
    alike = excess(kept**4)
    gain, needed = (heavy.value - normal.value) / alike, _needed_of_tails(len(fits.edges), alike)
    if gain > needed:
        gain = min(gain, gain_beside_strays(heavy, normal) / alike)
    if not gain > needed:
        return ""
    if not normal.settled:
        return "tails are heavier than normal ones (so many boxes fail the matching that no normal errors fit)"
    return f"tails are heavier than normal ones (log-likelihood {gain:.1f} larger, needs {needed:.1f})"


def _likeliest_normal(fits: ErrorFits, plain: matched_edges.Unit) -> ErrorFit | None:
    """Normal errors in the plain unit; where they are not settled, the likeliest ones that were found in any."""
    plain_fit = fits.likeliest_normal(plain)
    if plain_fit is None or plain_fit.settled:
        return plain_fit
    others = [fits.likeliest_normal(unit) for unit in ("px", "relative") if unit != plain]
    return max([plain_fit, *(fit for fit in others if fit is not None)], key=lambda fit: fit.value)


def _needed_of_tails(count: int, alike: float) -> float:
    return max(float(np.log(count / alike)), bootstrap.SIGNIFICANT**2) / 2


def _with_growth(fits: ErrorFits, plain: ChosenLaw, kept: float, without: frozenset[str]) -> ChosenLaw:
    """Mixed errors where they are clearly likelier than the kind that was chosen, else that kind."""
    alike, alike_tails = excess(kept**2), excess(kept**4)
    of_tails = _needed_of_tails(len(fits.edges), alike_tails) * alike_tails
    needed = max(_GROWTHS * np.log(len(fits.edges) / alike), _GROWTHS_SIGNIFICANT) / 2
    least = fits.value(plain.unit, plain.heavy)
    if not np.isfinite(least):  # others are not chosen because these did not settle
        unsettled = _likeliest_normal(fits, plain.unit)
        least = -np.inf if unsettled is None else unsettled.value
    normal = fits.value("mixed", least=fits.value(plain.unit))
    tailed = -np.inf
    if "student_t" not in without and _mixed_may_be_heavy(fits, plain):
        tailed = fits.value("mixed", heavy=True, least=least + needed * alike + of_tails * (not plain.heavy))
    tails = _tails(fits, "mixed", "mixed", kept) if tailed - normal > of_tails else ""
    normal = fits.value("mixed")  # which may have settled since, begun from that with heavy tails
    value = tailed - of_tails * (not plain.heavy) if tails else normal + of_tails * plain.heavy
    gain = (value - least) / alike
    if not gain > needed:
        return plain
    why = f"spreads have a fixed and a growing part (log-likelihood {gain:.1f} larger, needs {needed:.1f})"
    return ChosenLaw("mixed", "student_t", (why, tails)) if tails else ChosenLaw("mixed", reasons=(why,))


def _heavy_possible(fits: ErrorFits, relative: bool) -> bool:
    """Whether errors are enough, and spread so that the likelihood rises with heavy tails."""
    if len(fits.edges) < T_NEEDED or fits.fit("relative" if relative else "px") is None:
        return False
    return matched_edges.may_be_heavy(fits.unclipped(relative))


def _mixed_may_be_heavy(fits: ErrorFits, plain: ChosenLaw) -> bool:
    """Whether mixed errors with heavy tails may be likelier than the kind that was chosen."""
    normal = fits.fit("mixed")
    if normal is None or len(fits.edges) < T_NEEDED:
        return False
    far_below = not normal.settled and normal.value < fits.value(plain.unit)
    return plain.heavy or (not far_below and matched_edges.may_be_heavy(fits.over_spread(normal.model)))


def _sides_differ(edges: matched_edges.MatchedEdges) -> bool:
    low, high = np.quantile(edges.sides_px, [0.1, 0.9], axis=0)
    return bool(np.any(high > _MAX_ALIKE * low))


def _rough_value(fits: ErrorFits, relative: bool) -> float:
    """Mean log-likelihood of errors as normal ones where they may determine each other; −∞ from too few."""
    errors = fits.unclipped(relative)
    if len(errors) < 2:
        return -np.inf
    stretch = np.log(fits.edges.sides_px[:, :2]).sum(axis=1).mean() * 2 if relative else 0.0
    sign, logarithm = np.linalg.slogdet(np.cov(errors.T) + 1e-12 * np.eye(4))
    return float(-0.5 * logarithm - stretch) if sign > 0 else np.inf


# ---- Mean, standard deviation and correlation of box errors ----

CELLS = tuple((i, j) for i in range(4) for j in range(i, 4))  # cells of the upper triangle of a covariance


@dataclass(frozen=True, eq=False)
class ErrorMoments:
    """Mean (4,), standard deviation with n − 1 (4,) and correlation of the `ERROR_PAIRS` (6,) of box errors."""

    mean: bootstrap.Column
    std: bootstrap.Column
    correlation: bootstrap.Column

    @classmethod
    def of(cls, resampling: bootstrap.Resampling, image: Indices, errors: Array) -> ErrorMoments:
        """Moments of errors of shape (n, 4), given the image of each, shape (n,)."""
        mean, std, correlation = moments(resampling, image, errors)
        number = float(len(errors))
        return cls(
            bootstrap.Column(mean, "mean", np.full(4, number)),
            bootstrap.Column(std, "positive", np.full(4, number)),
            bootstrap.Column(correlation, "correlation", np.full(6, number)),
        )

    def covariance(self) -> bootstrap.Column:
        """Covariances of the `CELLS`, shape (10,)."""
        std, correlation = self.std.values, self.correlation.values
        of_pair = [correlation[:, ERROR_PAIRS.index(cell)] if cell in ERROR_PAIRS else 1.0 for cell in CELLS]
        values = [std[:, i] * std[:, j] * of for (i, j), of in zip(CELLS, of_pair, strict=True)]
        return bootstrap.Column(np.stack(values, axis=1), "mean", np.repeat(self.mean.counts[:1], len(CELLS)))


def covariance(std: Array, correlation: Array) -> Array:
    """Covariance from standard deviations and correlations of the `ERROR_PAIRS`, shapes (4, 4), (4,) and (6,)."""
    matrix = np.eye(4)
    for (i, j), value in zip(ERROR_PAIRS, correlation, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return np.outer(std, std) * matrix


def moments(resampling: bootstrap.Resampling, image: Indices, values: Array) -> tuple[Array, Array, Array]:
    """Mean, standard deviation and correlation of vectors (n, 4), shapes (rows, 4), (rows, 4) and (rows, 6)."""
    centre = values.mean(axis=0) if len(values) else np.zeros(4)
    moved = values - centre  # squares of small numbers keep their digits
    products = moved[:, :, None] * moved[:, None, :]
    sums = resampling.sums(image, np.column_stack([np.ones(len(values)), moved, products.reshape(-1, 16)]))
    number = sums[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = sums[:, 1:5] / number[:, None]
        second = sums[:, 5:].reshape(-1, 4, 4) - number[:, None, None] * mean[:, :, None] * mean[:, None, :]
        second = second / (number - 1)[:, None, None]
        std = np.sqrt(np.maximum(np.einsum("bii->bi", second), 0))
        correlation = np.stack([second[:, i, j] / (std[:, i] * std[:, j]) for i, j in ERROR_PAIRS], axis=1)
    few = number < 2
    correlation = np.where(np.isfinite(correlation), correlation, 0.0)
    std[few], correlation[few] = np.nan, np.nan
    return mean + centre, std, correlation


LAWS = ("normal", "student_t")  # distributions of box errors that can be learned, by `box_error.law` in a detector file
_PAIR_NAMES = tuple(f"{ERROR_COMPONENTS[i]},{ERROR_COMPONENTS[j]}" for i, j in ERROR_PAIRS)
_MAX_STEP = 5.0
_SHRUNK = 1e-5


@dataclass(frozen=True, eq=False)
class ErrorSample:
    """Sample from which the distribution of one state is learned."""

    errors: Array  # e_x, e_y, e_w, e_h in the unit as measured, shape (n, 4)
    image: Indices  # image of each, shape (n,)
    kept: float  # correlation of an error with that of the same vessel one frame before
    state: str  # name of the state
    unit: matched_edges.Unit  # what standard deviations follow
    fit: ErrorFit | None  # the likeliest distribution; None where the errors determine none

    def entry(self, name: str, column: bootstrap.Column, *axes: tuple[str, ...]) -> bootstrap.Entry:
        """A number of the distribution."""
        remark = {"mean": self.in_words, "std": self.in_words, "growth": "px/px"}.get(name, "")
        return bootstrap.Entry(bootstrap.Key((f"box_error_{name}",), self.state, axes, remark), column)

    @property
    def in_words(self) -> str:
        """The unit of the mean."""
        return "relative" if self.unit == "relative" else "px"

    def spread_of_means(self, power: int) -> float:
        """Standard error of the mean of powers of a standard normal error, which persist like it to that power."""
        return float(np.sqrt(excess(self.kept**power)) / np.sqrt(max(len(self.errors), 1)))


@dataclass(frozen=True, eq=False)
class LearnedErrors:
    """The distribution of the box errors of a state."""

    unit: matched_edges.Unit  # what standard deviations follow
    mean: bootstrap.Entry  # shape (4,)
    std: bootstrap.Entry  # standard deviation; of mixed errors its fixed part, shape (4,)
    correlation: bootstrap.Entry  # of the `ERROR_PAIRS`, shape (6,)
    growth: bootstrap.Entry | None = None  # growth of standard deviations with the side, shape (4,); None unless mixed
    degrees_of_freedom: bootstrap.Entry | None = None  # of Student's t law; None of others

    def section(self) -> dict[str, Any]:
        """The section `box_error` of a detector file."""
        section: dict[str, Any] = {"unit": self.unit}
        if self.degrees_of_freedom is not None:
            section |= {"law": "student_t", "degrees_of_freedom": bootstrap.nested(self.degrees_of_freedom.estimate)}
        mean, std, correlation = (np.nan_to_num(entry.estimate) for entry in (self.mean, self.std, self.correlation))
        section |= {"mean": bootstrap.nested(mean), "covariance": _written(_positive(covariance(std, correlation)))}
        if self.growth is not None:
            section["growth"] = bootstrap.nested(np.maximum(self.growth.estimate, 0.0))
        return section


def learned_errors(resampling: bootstrap.Resampling, sample: ErrorSample) -> LearnedErrors:
    """The numbers of one state, with replicates that spread at least as theory has it for errors that persist."""
    if sample.fit is None or (sample.fit.plain and not sample.fit.model.heavy and sample.unit != "mixed"):
        return _moments(resampling, sample)
    return _likeliest(resampling, sample, sample.fit)


def _moments(resampling: bootstrap.Resampling, sample: ErrorSample) -> LearnedErrors:
    """Moments of errors of which nothing is cut off."""
    moments = ErrorMoments.of(resampling, sample.image, sample.errors)
    mean, std, correlation = moments.mean, moments.std, moments.correlation
    of_sums, of_squares = sample.spread_of_means(1), sample.spread_of_means(2)
    least = (1 - correlation.estimate**2) * of_squares
    return LearnedErrors(
        sample.unit,
        sample.entry("mean", _wide(mean, std.estimate * of_sums), ERROR_COMPONENTS),
        sample.entry("std", _wide(std, std.estimate * of_squares / np.sqrt(2)), ERROR_COMPONENTS),
        sample.entry("correlation", _wide(correlation, least), _PAIR_NAMES),
    )


def _likeliest(resampling: bootstrap.Resampling, sample: ErrorSample, fit: ErrorFit) -> LearnedErrors:
    """Maximum likelihood; replicates by one Newton step from the estimate."""
    model, count, replicates = fit.model, len(fit.edges), len(resampling.weights) - 1
    inverse: Array = np.zeros((len(model.places), len(model.places)))
    steps: Array = np.zeros((1, len(model.places)))
    if replicates:
        inverse = np.asarray(np.linalg.inv(fit.information()), dtype=np.float64)
        steps = resampling.sums(fit.edges.image, fit.slopes().scores) @ inverse
        steps -= steps[0].copy()
        steps[:, 4:] = np.clip(steps[:, 4:], -_MAX_STEP, _MAX_STEP)
    freed = 1.0 if model.heavy else np.sqrt(count / max(count - 1, 1))
    i, j = np.array(ERROR_PAIRS).T
    # What follows the common scale of a vessel's errors persists like that scale does, other spreads like squares.
    of_spread = 1 if model.heavy else 2
    numbers: dict[str, tuple[Array, bootstrap.Kind, int]] = {
        "mean": (model.mean, "mean", 1),
        "std": (freed * model.std, "positive", of_spread),
        "correlation": (model.correlation[i, j], "correlation", 2),
    }
    if model.unit == "mixed":
        numbers["growth"] = (freed * model.growth, "mean", of_spread)
    if model.heavy:
        numbers["degrees_of_freedom"] = (np.array(model.freedom), "above_two", 1)
    axes = {"correlation": (_PAIR_NAMES,), "degrees_of_freedom": ()}
    entries, place = {}, 0
    for name, (number, kind, power) in numbers.items():
        span = slice(place, place := place + number.size)
        scaled = bootstrap.to_scale(number, kind) + steps[:, span].reshape(-1, *number.shape)
        error = np.sqrt(np.maximum(np.diag(inverse)[span], 0) * excess(sample.kept**power)).reshape(number.shape)
        values = bootstrap.from_scale(bootstrap.widened(scaled, error), kind)
        column = bootstrap.Column(values, kind, np.full(number.shape, float(count)))
        entries[name] = sample.entry(name, column, *axes.get(name, (ERROR_COMPONENTS,)))
    return LearnedErrors(model.unit, **entries)


def _wide(column: bootstrap.Column, least: Array) -> bootstrap.Column:
    return replace(column, values=bootstrap.widened(column.values, least))


def _positive(matrix: Array) -> Array:
    """A covariance (4, 4) without negative eigenvalues, which rounding or a correction may have left."""
    values, vectors = np.linalg.eigh(matrix)
    return matrix if values[0] >= 0 else (vectors * np.maximum(values, 0)) @ vectors.T


def _written(matrix: Array) -> Any:
    """A covariance (4, 4) in six digits; where rounding makes it invalid, its correlations are made 10⁻⁵ smaller."""
    rounded = bootstrap.nested(matrix)
    if not covariance_problems(rounded):
        return rounded
    return bootstrap.nested(matrix * np.where(np.eye(4, dtype=bool), 1.0, 1 - _SHRUNK))
