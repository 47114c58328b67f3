"""A detector's parameters, what a run shows of each, and the verdicts on all of them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from modsim3d.verify.law_measures import Occupancy
from modsim3d.verify.measures import ANY, Estimate, Interval, Measure, Noticed

OVERALL_ALPHA = 0.01
"""Probability that an honest run has any verdict against it; shared evenly among its tests (Bonferroni)."""
OBEYS, DIFFERS, FALLS_SHORT, UNTESTED = "obeys", "DIFFERS", "obeys its rule, not the asked rate", "too little seen"
UNCHECKED = "no check"


@dataclass(frozen=True)
class Parameter:
    """One parameter of a detector and what a run shows of it.

    Attributes:
        name: Its key in the detector file, or a description if it follows from other numbers.
        measure: The run's number and its law; None if the run shows too little.
        asked: The number in the file; the measure's if None.
        state: Name of the performance state, None if it belongs to none.
        in_file: Whether the file has this number; only such a parameter can be the cause of a failure.
        promised: The file's number where the model's own rule aims at another one, which is `measure.asked`.
        checked: Whether there is a check; a model without one is listed as such.
    """

    name: str
    group: str
    measure: Measure | None
    asked: float | None = None
    unit: str = ""
    state: str | None = None
    in_file: bool = True
    promised: float | None = None
    note: str = ""
    checked: bool = True

    def unless(self, note: str) -> Parameter:
        """The same without a measure if a note says why it cannot be tested."""
        return replace(self, measure=None, note=note) if note else self


@dataclass(frozen=True)
class Verdict:
    """A parameter with the verdict on it.

    Attributes:
        asked: The value asked for, by the model's rule where that differs from the file's.
        measured: None where there is no measure.
        interval: Interval of the measured value, at the level of all tests together, cut to what is possible.
        p_value: The p-value before correction for the number of tests.
        noticed: Smallest change below and above the asked value that this run would have shown, with 90 % power.
        verdict: `OBEYS`, `DIFFERS`, `FALLS_SHORT`, `UNTESTED` or `UNCHECKED`.
    """

    parameter: Parameter
    asked: float
    measured: float | None
    interval: Interval | None
    p_value: float | None
    noticed: Noticed
    verdict: str

    @property
    def fails(self) -> bool:
        """Whether the run does not obey its file in this parameter."""
        return self.verdict == DIFFERS


@dataclass(frozen=True)
class Verification:
    """Whether a run obeys its detector file: a verdict on each parameter, at level `alpha`."""

    verdicts: tuple[Verdict, ...]
    alpha: float

    @property
    def failed(self) -> tuple[Verdict, ...]:
        """The verdicts against the run."""
        return tuple(verdict for verdict in self.verdicts if verdict.fails)

    @property
    def obeys(self) -> bool:
        """Whether nothing speaks against the run."""
        return not self.failed

    @property
    def cause(self) -> Verdict | None:
        """The failing verdict that stands out most, first of all of those in the file; None if none fails."""
        return max(self.failed, key=lambda verdict: (verdict.parameter.in_file, _strength(verdict)), default=None)


def _strength(verdict: Verdict) -> float:
    measure = verdict.parameter.measure
    # To six digits: between two entries that say the same, rounding must not decide.
    return 0.0 if measure is None else float(f"{measure.strength():.6g}")


def judge(parameters: Sequence[Parameter]) -> Verification:
    """Verdicts at a level such that an honest run has one against it with probability `OVERALL_ALPHA` at most."""
    tests = sum(parameter.measure is not None for parameter in parameters)
    alpha = OVERALL_ALPHA / max(tests, 1)
    return Verification(tuple(_verdict(parameter, alpha) for parameter in parameters), alpha)


def _verdict(parameter: Parameter, alpha: float) -> Verdict:
    measure = parameter.measure
    if measure is None:
        asked = float("nan") if parameter.asked is None else parameter.asked
        return Verdict(parameter, asked, None, None, None, (None, None), UNTESTED if parameter.checked else UNCHECKED)
    p_value = measure.p_value()
    verdict = OBEYS if p_value >= alpha else DIFFERS
    low, high = measure.possible if isinstance(measure, Estimate) else ANY
    shown = (*measure.interval(alpha), measure.measured)
    start, end, measured = (min(max(value, low), high) for value in shown)
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
    return Verdict(parameter, measure.asked, measured, (start, end), p_value, noticed, verdict)
