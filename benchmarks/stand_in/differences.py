"""Paired differences of scores, simulated minus real, where the film is the unit, and what they show.

The detector that looks at pixels has one output for a film, the simulated one has as many as seeds. So a film gives one
difference: the mean over its seeds minus the real score. More seeds make that exact; only more films narrow the rest.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array

LEVEL = 0.95
Verdict = Literal["agrees", "differs", "not enough films to say"]
AGREES: Verdict = "agrees"
DIFFERS: Verdict = "differs"
UNDECIDED: Verdict = "not enough films to say"
MIN_FILMS = 2


@dataclass(frozen=True)
class Difference:
    """The difference of a score over films.

    Attributes:
        films: Number of films in which both scores are defined.
        real: Mean of the real scores; None without films.
        simulated: Mean of the simulated ones.
        mean: Mean difference, simulated minus real.
        low: Lower end of its 95 % interval by Student's t over films; None of fewer than two films.
        high: Upper end.
        between: Standard deviation of the difference from film to film that would be left with any number of seeds.
        within: Standard deviation of the score from seed to seed of one film; None with one seed.
        scatter: Standard deviation of the difference over what it would be if the real output of a film were one like
            the simulated ones; None where that is 0 or not known.
        scatter_p: The chance of so large a one if it were, by an F-test; None where `scatter` is.
        margin: How far the two may lie apart.
        p_value: Of the two one-sided tests: the chance of a mean so far inside the margin if the true difference were
            at its edge; None of fewer than two films.
        verdict: `agrees`: the whole interval lies inside the margin, which is two one-sided tests at 2.5 %; `differs`:
            all of it lies outside; otherwise there are not enough films to say.
    """

    films: int
    real: float | None
    simulated: float | None
    mean: float | None = None
    low: float | None = None
    high: float | None = None
    between: float | None = None
    within: float | None = None
    scatter: float | None = None
    scatter_p: float | None = None
    margin: float | None = None
    p_value: float | None = None
    verdict: Verdict = UNDECIDED

    def as_json(self) -> dict[str, Any]:
        """The numbers as JSON has them."""
        return asdict(self)


def difference(real: Array, simulated: Array, margin: float) -> Difference:
    """Compare scores of F films.

    Args:
        real: The score on each film, NaN where it is undefined, shape (F,).
        simulated: The score with each of S seeds, NaN where it is undefined, shape (F, S).
        margin: How far the two may lie apart.
    """
    known = ~np.isnan(real) & ~np.isnan(simulated).all(axis=1)
    real, simulated = real[known], simulated[known]
    films = len(real)
    if films < MIN_FILMS:
        return Difference(films, *_means(real, simulated), margin=margin)
    apart = np.nanmean(simulated, axis=1) - real
    mean, deviation = float(apart.mean()), float(apart.std(ddof=1))
    error = deviation / np.sqrt(films)
    half = float(special.stdtrit(films - 1, (1 + LEVEL) / 2)) * error
    between, within = _split(deviation, simulated)
    scatter, scatter_p = _scatter(deviation, within, simulated)
    return Difference(
        films,
        *_means(real, simulated),
        mean,
        mean - half,
        mean + half,
        between,
        within,
        scatter,
        scatter_p,
        margin,
        _p_value(mean, error, films, margin),
        verdict(mean - half, mean + half, margin),
    )


def verdict(low: float, high: float, margin: float) -> Verdict:
    """What an interval of a difference shows."""
    if -margin <= low and high <= margin:
        return AGREES
    return DIFFERS if low > margin or high < -margin else UNDECIDED


def _means(real: Array, simulated: Array) -> tuple[float | None, float | None]:
    if not len(real):
        return None, None
    return float(real.mean()), float(np.nanmean(simulated, axis=1).mean())


def _split(deviation: float, simulated: Array) -> tuple[float, float | None]:
    """Standard deviation from film to film without that of the seeds, and that from seed to seed of a film."""
    counts = (~np.isnan(simulated)).sum(axis=1)
    several = counts > 1
    if not several.any():
        return deviation, None
    variance = float(np.nanvar(simulated[several], axis=1, ddof=1).mean())
    between = max(deviation**2 - variance * float((1 / counts).mean()), 0.0)
    return float(np.sqrt(between)), float(np.sqrt(variance))


def _scatter(deviation: float, within: float | None, simulated: Array) -> tuple[float | None, float | None]:
    """How much more the difference scatters over films than one seed against the mean of the others would."""
    counts = (~np.isnan(simulated)).sum(axis=1)
    if not within:
        return None, None
    ratio = deviation**2 / (within**2 * (1 + float((1 / counts).mean())))
    return float(np.sqrt(ratio)), float(special.fdtrc(len(counts) - 1, int((counts - 1).sum()), ratio))


def _p_value(mean: float, error: float, films: int, margin: float) -> float:
    """The larger p-value of the two one-sided tests."""
    inside = margin - abs(mean)
    if error == 0:
        return 0.0 if inside >= 0 else 1.0
    return float(special.stdtr(films - 1, -inside / error))
