"""Which kind of distribution the box errors of a state speak for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.learn.box_error_fits.error_fits import ErrorFits
from modsim3d.learn.box_error_fits.error_model import Unit
from modsim3d.learn.box_error_fits.matched_edges import MatchedEdges
from modsim3d.learn.box_error_fits.student_t_fit import may_be_heavy
from modsim3d.learn.numbers.resampling import SIGNIFICANT

T_NEEDED = MIXED_NEEDED = 100
"""Errors of a state that a choice between distributions needs."""
_GROWTHS, _GROWTHS_SIGNIFICANT = 4, 18.5
"""Numbers that mixed errors have more, and what chi-square of so many exceeds once in a thousand times."""
_MOST_ALIKE, _ALIKE = 1.1, 0.1


def excess(kept: float) -> float:
    """Variance of a sum of numbers of which a share is kept from one to the next, over that of independent ones."""
    return (1 + kept) / (1 - kept)


@dataclass(frozen=True)
class ChosenLaw:
    """A kind of distribution, with what speaks for it where it is not the plainest."""

    unit: Unit
    heavy: bool = False
    reasons: tuple[str, ...] = ()


def plain_unit(fits: ErrorFits, without: frozenset[str]) -> Unit:
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
    """The kind of distribution that the errors clearly speak for, given their correlation from frame to frame.

    Twice the gain in log-likelihood, over the number of errors that count as one because they persist, must pass the
    Bayesian information criterion and `SIGNIFICANT`. Heavy tails follow fourth powers of the errors, growth squares.
    """
    unit = plain_unit(fits, without)
    chosen = ChosenLaw(unit)
    if "student_t" not in without:
        best = -np.inf
        for each in (unit,) if "relative" in without else (unit, _other(unit)):
            reason = heavy_tails(fits, each, kept, fits.value(unit))
            if reason and fits.value(each, heavy=True) > best:
                best, chosen = fits.value(each, heavy=True), ChosenLaw(each, True, (reason,))
    if "mixed" not in without and len(fits.edges) >= MIXED_NEEDED and _sides_differ(fits.edges):
        chosen = _with_growth(fits, chosen, kept, without)
    return chosen


def _other(unit: Unit) -> Unit:
    return "px" if unit == "relative" else "relative"


def heavy_tails(fits: ErrorFits, unit: Unit, kept: float, normal: float | None = None) -> str:
    """Why Student's t law describes errors in a unit better than normal ones; empty if it does not.

    `normal` is the log-likelihood of the normal ones, by default in the same unit.
    """
    if not _heavy_possible(fits, unit == "relative"):
        return ""
    normal, alike = fits.value(unit) if normal is None else normal, excess(kept**4)
    least = normal + alike * _needed_of_tails(len(fits.edges), alike)
    return _tails(fits.value(unit, heavy=True, least=least) - normal, len(fits.edges), kept)


def _tails(gain: float, count: int, kept: float) -> str:
    alike = excess(kept**4)
    gain, needed = gain / alike, _needed_of_tails(count, alike)
    if not gain > needed:
        return ""
    if not np.isfinite(gain):
        return "tails are heavier than normal ones (so many boxes fail the matching that no normal errors fit)"
    return f"tails are heavier than normal ones (log-likelihood {gain:.1f} larger, needs {needed:.1f})"


def _needed_of_tails(count: int, alike: float) -> float:
    return max(float(np.log(count / alike)), SIGNIFICANT**2) / 2


def _with_growth(fits: ErrorFits, plain: ChosenLaw, kept: float, without: frozenset[str]) -> ChosenLaw:
    """Mixed errors where they are clearly likelier than the kind that was chosen, else that kind."""
    alike, alike_tails = excess(kept**2), excess(kept**4)
    of_tails = _needed_of_tails(len(fits.edges), alike_tails) * alike_tails
    needed = max(_GROWTHS * np.log(len(fits.edges) / alike), _GROWTHS_SIGNIFICANT) / 2
    least = fits.value(plain.unit, plain.heavy)
    normal = fits.value("mixed", least=fits.value(plain.unit))
    tailed = -np.inf
    if "student_t" not in without and _mixed_may_be_heavy(fits, plain):
        tailed = fits.value("mixed", heavy=True, least=least + needed * alike + of_tails * (not plain.heavy))
    mixed_heavy = tailed - normal > of_tails
    value = (tailed if mixed_heavy else normal) - of_tails * (mixed_heavy - plain.heavy)
    gain = (value - least) / alike
    if not gain > needed:
        return plain
    why = f"spreads have a fixed and a growing part (log-likelihood {gain:.1f} larger, needs {needed:.1f})"
    tails = _tails(tailed - normal, len(fits.edges), kept) if mixed_heavy else ""
    return ChosenLaw("mixed", mixed_heavy, (why, tails) if tails else (why,))


def _heavy_possible(fits: ErrorFits, relative: bool) -> bool:
    """Whether errors are enough, and spread so that the likelihood rises with heavy tails."""
    if len(fits.edges) < T_NEEDED or fits.fit("relative" if relative else "px") is None:
        return False
    return may_be_heavy(fits.unclipped(relative))


def _mixed_may_be_heavy(fits: ErrorFits, plain: ChosenLaw) -> bool:
    """Whether mixed errors with heavy tails may be likelier than the kind that was chosen."""
    normal = fits.fit("mixed")
    if normal is None or len(fits.edges) < T_NEEDED:
        return False
    far_below = not normal.settled and normal.value < fits.value(plain.unit)
    return plain.heavy or (not far_below and may_be_heavy(fits.over_spread(normal.model)))


def _sides_differ(edges: MatchedEdges) -> bool:
    """Whether widths or heights differ so much that errors could follow them."""
    low, high = np.quantile(edges.sides_px, [0.1, 0.9], axis=0)
    return bool(np.any(high > _MOST_ALIKE * low))


def _rough_value(fits: ErrorFits, relative: bool) -> float:
    """Mean log-likelihood of errors as normal ones where they may determine each other; −∞ from too few."""
    errors = fits.unclipped(relative)
    if len(errors) < 2:
        return -np.inf
    stretch = np.log(fits.edges.sides_px[:, :2]).sum(axis=1).mean() * 2 if relative else 0.0
    sign, logarithm = np.linalg.slogdet(np.cov(errors.T) + 1e-12 * np.eye(4))
    return float(-0.5 * logarithm - stretch) if sign > 0 else np.inf
