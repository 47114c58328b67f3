"""How often verdicts are wrong: each, and all of a campaign together."""

from __future__ import annotations

from dataclasses import dataclass

from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import cases_of
from modsim3d.campaign.verdicts.wording import percent


@dataclass(frozen=True)
class Levels:
    """The greatest probabilities of error of the verdicts of a campaign.

    Attributes:
        verdicts: Number of verdicts: for each requirement one for each tracker, condition and state.
        met: That a requirement that does not hold is called met; the greatest of all verdicts.
        failed: That a requirement that holds is called failed; the greatest of all verdicts.
        all_met: That all are called met although one does not hold: an error of that one, so no greater than `met`.
        any_wrong: That one verdict or more is wrong: at most the sum of all (union bound).
        sequential: Whether this holds however often the campaign is looked at; else it is looked at once.
        by_t: Whether a mean is judged by Student's t, for which the numbers are approximate.
    """

    verdicts: int
    met: float
    failed: float
    all_met: float
    any_wrong: float
    sequential: bool
    by_t: bool

    def sentences(self) -> list[str]:
        """The levels in words."""
        if not self.verdicts:
            return []
        looked = "however often the campaign is looked at" if self.sequential else "if the campaign is looked at once"
        found = [
            f"A requirement that does not hold is called met with a probability of at most {_percent(self.met)}, and "
            f"one that holds is called failed with at most {_percent(self.failed)}, {looked}.",
        ]
        if self.verdicts > 1:
            found.append(
                f"If all {self.verdicts:,} verdicts are met, that is wrong with a probability of at most "
                f"{_percent(self.all_met)}."
            )
        if self.verdicts > 1 and self.any_wrong < 1:
            found.append(
                f"That one or more of the {self.verdicts:,} verdicts are wrong has a probability of at most "
                f"{_percent(self.any_wrong)}."
            )
        if self.by_t:
            found.append("Means are judged by Student's t: exact for normal values, approximate for others.")
        return found


def levels_of(plan: Plan) -> Levels:
    """The levels of a campaign."""
    errors = [1 - each.confidence for each in plan.keys.require for _ in cases_of(plan, each)]
    greatest, sequential = max(errors, default=0.0), plan.keys.stop == "sequential"
    by_t = not sequential and any(each.share is None for each in plan.keys.require)
    return Levels(len(errors), greatest, greatest, greatest, min(1.0, sum(errors)), sequential, by_t)


def _percent(probability: float) -> str:
    return percent(round(probability, 12))
