"""How often the intervals of many voyages hold what is known, against binomial limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binom

from benchmarks.voyages.trials import LEVEL, Number, holds

SURE = 0.99
"""An interval that claims 95 % falls below the limit in 1 % of the campaigns at most, if it claims rightly."""
PARTS = ("registration", "detector")


def fewest(count: int) -> int:
    """The fewest intervals that hold, of so many at 95 %, with a probability of at least 1 %."""
    return int(binom.ppf(1 - SURE, count, LEVEL)) if count else 0


def scores(trials: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The scores of a case.

    Returns:
        `voyages`, `refused` (reason → number), `cpu_s` of a voyage, the estimates of the `first` voyage, and for
        `registration` and `detector` each number with the least and the greatest true value, how many intervals hold,
        of how many that are known, the fewest that may, how often it is said to be an upper bound or unknown, bias and
        spread of the estimates, and the median half-width of the intervals.
    """
    reasons = [trial["refused"] for trial in trials if "refused" in trial]
    found: dict[str, Any] = {
        "voyages": len(trials),
        "refused": {reason: reasons.count(reason) for reason in sorted(set(reasons))},
        "cpu_s": round(float(np.mean([trial["cpu_s"] for trial in trials])), 2),
    }
    first = {name: number for part in PARTS for name, number in trials[0].get(part, {}).items()}
    found["first"] = {name: float(f"{number['value']:.6g}") for name, number in first.items()}
    for part in PARTS:
        done = [trial[part] for trial in trials if trial.get(part)]
        names = dict.fromkeys(name for each in done for name in each)
        if done:
            found[part] = {name: _score([each[name] for each in done if name in each]) for name in names}
    return found


def _score(numbers: Sequence[Number]) -> dict[str, float]:
    asked, value = (np.array([each[key] for each in numbers]) for key in ("asked", "value"))
    known = [each for each in numbers if not each.get("unknown")]
    widths = [each["high"] - each["low"] for each in known]
    return {
        "asked": float(f"{asked.min():.6g}"),
        "greatest_asked": float(f"{asked.max():.6g}"),
        "held": sum(holds(each) for each in known),
        "of": len(known),
        "fewest": fewest(len(known)),
        "bounds": sum(bool(each.get("bound")) for each in numbers),
        "unknown": len(numbers) - len(known),
        "bias": float(f"{(value - asked).mean():.6g}"),
        "spread": float(f"{(value - asked).std():.6g}"),
        "half_width": float(f"{np.median(widths) / 2:.6g}") if known else 0.0,
    }


def below(part: dict[str, dict[str, float]]) -> list[str]:
    """Numbers whose intervals hold less often than 95 % allows."""
    return [name for name, score in part.items() if score["held"] < score["fewest"]]


def share(part: dict[str, dict[str, float]]) -> float:
    """Share of all intervals that hold."""
    return sum(score["held"] for score in part.values()) / max(sum(score["of"] for score in part.values()), 1)
