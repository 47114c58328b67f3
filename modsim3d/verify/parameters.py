"""A detector's parameters, what a run shows of each, and the verdicts on all of them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special
from scipy.stats import kstwo

from modsim3d.core.arrays import Array
from modsim3d.verify.measures import ANY, POWER, Estimate, Interval, Measure, Noticed, two_sided


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Share of the frames that a state takes, against the law of a Markov chain: the probability of each number of
    frames from 0 on, shape (frames + 1,)."""

    found: int
    law: Array

    @property
    def asked(self) -> float:
        """Expected share."""
        return float(np.arange(len(self.law)) @ self.law) / self._frames

    @property
    def measured(self) -> float:
        """Share found."""
        return self.found / self._frames

    @property
    def _frames(self) -> int:
        return max(len(self.law) - 1, 1)

    @property
    def _deviation(self) -> float:
        counts = np.arange(len(self.law))
        return float(np.sqrt(max(float(((counts / self._frames - self.asked) ** 2) @ self.law), 0.0)))

    @property
    def count(self) -> float:
        """Independent frames that are worth as much."""
        variance = self._deviation**2
        return self.asked * (1 - self.asked) / variance if variance > 0 else float(self._frames)

    def p_value(self) -> float:
        """From the law itself."""
        return two_sided(float(self.law[: self.found + 1].sum()), float(self.law[self.found :].sum()))

    def strength(self) -> float:
        """In standard deviations of the law."""
        return abs(self.measured - self.asked) / self._deviation if self._deviation > 0 else 0.0

    def interval(self, alpha: float) -> Interval:
        """The share found, and as far to each side as the law may reach to the other."""
        cumulative = np.cumsum(self.law)
        low = int(np.searchsorted(cumulative, alpha / 2)) / self._frames
        high = int(np.searchsorted(cumulative, 1 - alpha / 2)) / self._frames
        return max(self.measured + self.asked - high, 0.0), min(self.measured + self.asked - low, 1.0)

    def noticed(self, alpha: float) -> Noticed:
        """Nothing: the transitions, which this follows from, notice more."""
        return None, None


@dataclass(frozen=True)
class Law:
    """Greatest distance between an empirical distribution function and the one asked for (Kolmogorov (1933))."""

    measured: float
    count: float
    asked: float = 0.0

    @classmethod
    def of(cls, values: Array, quantiles: Array) -> Law:
        """Distance of values (n,) from a law straight between evenly spaced quantiles (k,); cautious at its steps."""
        share, steps = np.linspace(0, 1, len(quantiles)), np.flatnonzero(np.diff(quantiles) > 0)
        ordered = np.sort(values)
        # At equal quantiles the distribution function is the last share from above, and the first from below.
        last, first = np.append(steps, len(quantiles) - 1), np.append(0, steps + 1)
        below = np.interp(ordered, quantiles[last], share[last])
        above = np.interp(ordered, quantiles[first], share[first])
        # A step of the law takes in every rank within it.
        high = np.searchsorted(ordered, ordered, side="right") / len(ordered) - below
        low = above - np.searchsorted(ordered, ordered, side="left") / len(ordered)
        return cls(float(max(high.max(initial=0), low.max(initial=0), 0.0)), len(ordered))

    def p_value(self) -> float:
        """p-value of the two-sided test."""
        return float(kstwo.sf(self.measured, int(self.count)))

    def strength(self) -> float:
        """The normal deviate of as small a p-value."""
        return float(-special.ndtri(max(self.p_value() / 2, 1e-300)))

    def interval(self, alpha: float) -> Interval:
        """Distances that are no farther from this one than chance may bring it."""
        reach = float(kstwo.isf(alpha, int(self.count)))
        return max(self.measured - reach, 0.0), min(self.measured + reach, 1.0)

    def noticed(self, alpha: float) -> Noticed:
        """A distance that the test does not miss: what chance may bring, from both sides."""
        reach = float(kstwo.isf(alpha, int(self.count)) + kstwo.isf(1 - POWER, int(self.count)))
        return None, reach if reach <= 1 else None


OVERALL_ALPHA = 0.01  # probability that an honest run has any verdict against it, shared by its tests (Bonferroni)
OBEYS, DIFFERS, FALLS_SHORT, UNTESTED = "obeys", "DIFFERS", "obeys its rule, not the asked rate", "too little seen"
UNCHECKED = "no check"


@dataclass(frozen=True)
class Parameter:
    """One parameter of a detector and what a run shows of it."""

    name: str  # its key in the detector file, or a description if it follows from other numbers
    group: str
    measure: Measure | None  # the run's number and its law; None if the run shows too little
    asked: float | None = None  # the number in the file; the measure's if None
    unit: str = ""
    state: str | None = None  # name of the performance state, None if it belongs to none
    in_file: bool = True  # whether the file has this number; only such a parameter can be the cause of a failure
    promised: float | None = None  # the file's number where the model's own rule aims at another, `measure.asked`
    note: str = ""
    checked: bool = True  # whether there is a check; a model without one is listed as such

    def unless(self, note: str) -> Parameter:
        """Parameter without a measure if a note says why it cannot be tested."""
        return replace(self, measure=None, note=note) if note else self


@dataclass(frozen=True)
class TestResult:
    """A parameter with the verdict on it."""

    parameter: Parameter
    asked: float  # the value asked for, by the model's rule where that differs from the file's
    measured: float | None  # None where there is no measure
    interval: Interval | None  # of the measured value, at the level of all tests together, cut to what is possible
    p_value: float | None  # before correction for the number of tests
    noticed: Noticed  # smallest change below and above the asked value that this run would have shown, with 90 % power
    verdict: str  # `OBEYS`, `DIFFERS`, `FALLS_SHORT`, `UNTESTED` or `UNCHECKED`

    @property
    def fails(self) -> bool:
        """Whether the run does not obey its file in this parameter."""
        return self.verdict == DIFFERS


@dataclass(frozen=True)
class Verification:
    """Whether a run obeys its detector file: a verdict on each parameter, at level `alpha`."""

    verdicts: tuple[TestResult, ...]
    alpha: float

    @property
    def failed(self) -> tuple[TestResult, ...]:
        """The verdicts against the run."""
        return tuple(verdict for verdict in self.verdicts if verdict.fails)

    @property
    def obeys(self) -> bool:
        """Whether nothing speaks against the run."""
        return not self.failed

    @property
    def cause(self) -> TestResult | None:
        """The failing verdict that stands out most, first of all of those in the file; None if none fails."""
        return max(self.failed, key=lambda verdict: (verdict.parameter.in_file, _strength(verdict)), default=None)


def _strength(verdict: TestResult) -> float:
    measure = verdict.parameter.measure
    # To six digits: between two entries that say the same, rounding must not decide.
    return 0.0 if measure is None else float(f"{measure.strength():.6g}")


def judge(parameters: Sequence[Parameter]) -> Verification:
    """Verdicts at a level such that an honest run has one against it with probability `OVERALL_ALPHA` at most."""
    alpha = OVERALL_ALPHA / max(sum(parameter.measure is not None for parameter in parameters), 1)
    return Verification(tuple(_verdict(parameter, alpha) for parameter in parameters), alpha)


def _verdict(parameter: Parameter, alpha: float) -> TestResult:
    measure = parameter.measure
    if measure is None:
        asked = float("nan") if parameter.asked is None else parameter.asked
        verdict = UNTESTED if parameter.checked else UNCHECKED
        return TestResult(parameter, asked, None, None, None, (None, None), verdict)
    p_value = measure.p_value()
    verdict = OBEYS if p_value >= alpha else DIFFERS
    low, high = measure.possible if isinstance(measure, Estimate) else ANY
    start, end, measured = (min(max(value, low), high) for value in (*measure.interval(alpha), measure.measured))
    below, above = measure.noticed(alpha)
    noticed = (
        None if below is None or measure.asked - below < low else below,
        None if above is None or measure.asked + above > high else above,
    )
    if verdict == OBEYS and parameter.promised is not None and not start <= parameter.promised <= end:
        verdict = FALLS_SHORT
    is_blind = noticed == (None, None)
    if isinstance(measure, Occupancy):  # the transitions, which it follows from, say what is noticed
        is_blind = all(replace(measure, found=end).p_value() >= alpha for end in (0, len(measure.law) - 1))
    if verdict == OBEYS and is_blind:
        verdict = UNTESTED
    return TestResult(parameter, measure.asked, measured, (start, end), p_value, noticed, verdict)
