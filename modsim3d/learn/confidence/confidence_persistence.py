"""How long the confidence of a vessel's detections persists.

A confidence has a level in the distribution of its state, and the level a normal number. Clipped confidences leave that
number open beyond a bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from modsim3d.arrays import Array
from modsim3d.detector.confidence import SCORES
from modsim3d.detector.confidence import Scores as Law
from modsim3d.detector.confidence_levels import LEVELS
from modsim3d.detector.confidence_pairs import pair_likelihood
from modsim3d.detector.parts import model_name
from modsim3d.learn.confidence.scores import Scores
from modsim3d.learn.numbers.resampling import Column, Resampling, widened
from modsim3d.learn.observed.observed import Observed
from modsim3d.learn.persistence.persistence_fit import Consecutive, Steps, steps_between

_STEP = 1e-4
"""Levels that a single confidence may have, above which its number counts as open between them."""
_GRID, _ROUNDS, _NEAR = 40, 30, 1e-3
_MOST_STEP, _SETTLED = 0.3, 1e-5
_SHORTEST, _LONGEST = 0.05, 1000.0
"""Correlation times are sought between these multiples of the usual time between sightings."""


@dataclass(frozen=True, eq=False)
class LatentScores:
    """Bounds of the normal numbers behind confidences, equal where known, NaN without a law; shapes (n,)."""

    low: Array
    high: Array

    @classmethod
    def of(cls, scores: Scores, law: Law, shift: Array, threshold: float) -> LatentScores:
        """From a distribution that is shifted by (n,) before it is clipped."""
        check = LEVELS.get(model_name(SCORES, law))
        levels = None if check is None else check(law, scores.values, shift)
        if levels is None:
            return cls(np.full(len(scores), np.nan), np.full(len(scores), np.nan))
        middle, least = (levels[0] + levels[1]) / 2, 0.5 / max(len(scores), 1)
        wide = levels[1] - levels[0] > _STEP
        known = special.ndtri(np.clip(middle, least, 1 - least))
        low = np.where(wide, special.ndtri(np.clip(levels[0], 0, 1 - least)), known)
        high = np.where(wide, special.ndtri(np.clip(levels[1], least, 1)), known)
        return cls(np.where(scores.values <= threshold, -np.inf, low), np.where(scores.values >= 1, np.inf, high))

    @property
    def known(self) -> Array:
        """Which numbers are known, shape (n,)."""
        found: Array = self.low == self.high
        return found

    @property
    def expected(self) -> Array:
        """The numbers; those that are open by their expectation, shape (n,)."""
        chance = np.maximum(special.ndtr(self.high) - special.ndtr(self.low), 1e-12)
        density = [np.exp(-(edge**2) / 2) / np.sqrt(2 * np.pi) for edge in (self.low, self.high)]
        found: Array = np.where(self.known, self.low, (density[0] - density[1]) / chance)
        return found


@dataclass(frozen=True, eq=False)
class ConsecutiveScores:
    """Numbers behind the confidences of the same thing in consecutive sightings."""

    latent: LatentScores
    steps: Steps
    scores: Scores

    @classmethod
    def of(cls, observed: Observed, scores: Scores, latent: LatentScores) -> ConsecutiveScores:
        """Of true detections in the order of `observed.found`."""
        usable = np.flatnonzero(~np.isnan(latent.low))
        steps = steps_between(observed.labelled, observed.rows[observed.found[usable]])
        return cls(latent, Steps(usable[steps.earlier], usable[steps.later], steps.apart_s), scores)

    def products(self) -> Consecutive:
        """For the decision whether confidence persists."""
        expected, (a, b) = self.latent.expected, (self.steps.earlier, self.steps.later)
        return Consecutive(expected[a] * expected[b], expected[a] ** 2, self.steps.apart_s, self.scores.image[b])

    @property
    def _known_before(self) -> Steps:
        known = self.latent.known[self.steps.earlier]
        return Steps(self.steps.earlier[known], self.steps.later[known], self.steps.apart_s[known])

    def _likelihood(self, steps: Steps, at: Array) -> Array:
        """Log-likelihood of each later sighting given the earlier one, shape (m,).

        At the logarithms of a correlation time and of a factor of all numbers, which a wrong spread makes.
        """
        a, b = steps.earlier, steps.later
        correlation = np.minimum(np.exp(-steps.apart_s / np.exp(at[0])), 1 - 1e-9)
        return pair_likelihood(
            self.latent.low[a], self.latent.low[b], self.latent.high[b], correlation, float(np.exp(at[1]))
        )

    def _derivatives(self, steps: Steps, at: Array) -> tuple[Array, Array]:
        """Gradient (m, 2) and curvature (m, 2, 2) of each log-likelihood, by differences."""
        moves = _NEAR * np.eye(2)
        ahead, behind = ([self._likelihood(steps, at + sign * move) for move in moves] for sign in (1, -1))
        middle = self._likelihood(steps, at)
        both = self._likelihood(steps, at + moves[0] + moves[1]) + self._likelihood(steps, at - moves[0] - moves[1])
        gradient = np.column_stack([(ahead[k] - behind[k]) / (2 * _NEAR) for k in range(2)])
        curvature = np.empty((len(middle), 2, 2))
        for k in range(2):
            curvature[:, k, k] = (2 * middle - ahead[k] - behind[k]) / _NEAR**2
        mixed = (both - sum(ahead) - sum(behind) + 2 * middle) / (2 * _NEAR**2)
        curvature[:, 0, 1] = curvature[:, 1, 0] = -mixed
        return gradient, curvature

    def _likeliest(self) -> Array | None:
        """Logarithms of the likeliest correlation time and factor; None where no earlier number is known."""
        steps = self._known_before
        if not len(steps):
            return None
        low, high = np.log(float(np.median(steps.apart_s)) * np.array([_SHORTEST, _LONGEST]))
        tried = [np.array([at, 0.0]) for at in np.linspace(low, high, _GRID)]
        best = max(tried, key=lambda at: float(self._likelihood(steps, at).sum()))
        for _ in range(_ROUNDS):
            gradient, curvature = (part.sum(axis=0) for part in self._derivatives(steps, best))
            curvature = curvature + max(0.0, 1e-9 - 2 * float(np.linalg.eigvalsh(curvature)[0])) * np.eye(2)
            step = np.clip(np.linalg.solve(curvature, gradient), -_MOST_STEP, _MOST_STEP)
            best = np.clip(best + step, [low, -1.0], [high, 1.0])
            if np.abs(step).max() < _SETTLED:
                break
        return best

    def time_s(self) -> float:
        """The likeliest correlation time; 0 where no earlier number is known."""
        best = self._likeliest()
        return 0.0 if best is None else float(np.exp(best[0]))

    def column(self, resampling: Resampling) -> Column:
        """The correlation time; replicates by one Newton step of its logarithm and of the factor."""
        best, steps = self._likeliest(), self._known_before
        if best is None:
            return Column(np.zeros(len(resampling.weights)), "positive", np.array(0.0))
        gradient, curvature = self._derivatives(steps, best)
        image, inverse = self.scores.image[steps.later], np.linalg.pinv(curvature.sum(axis=0))
        bends, slopes = resampling.sums(image, curvature), resampling.sums(image, gradient)
        sound = np.linalg.eigvalsh(bends)[:, 0] > np.linalg.eigvalsh(bends[0])[0] / 10
        own = np.linalg.solve(np.where(sound[:, None, None], bends, np.eye(2)), slopes[..., None])[:, 0, 0]
        moves = np.where(sound, own, slopes @ inverse[0])
        moves[0] = 0.0
        spread = np.sqrt(np.maximum((inverse @ (gradient.T @ gradient) @ inverse)[0, 0], 0))
        times = np.exp(best[0] + widened(np.clip(moves, -2, 2), np.array(spread)))
        return Column(times, "positive", np.array(float(len(steps))))
