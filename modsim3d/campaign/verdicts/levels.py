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
        mean_wrong: The sum itself: so many verdicts are wrong at most, in the mean of many such campaigns.
        sequential: Whether this holds however often the campaign is looked at; else it is looked at once.
        family: Whether the level is that of all verdicts that are met, and of all that failed, by Holm's step-down.
        measured: Whether a mean is judged by a bound whose errors were measured and not proved.
    """

    verdicts: int
    met: float
    failed: float
    all_met: float
    any_wrong: float
    mean_wrong: float
    sequential: bool
    measured: bool
    family: bool = False

    def sentences(self) -> list[str]:
        """The levels in words."""
        if not self.verdicts:
            return []
        looked = "however often the campaign is looked at" if self.sequential else "if the campaign is looked at once"
        looked += ", of means as far as it was measured" if self.measured else ""
        found = [
            f"A requirement that does not hold is called met with a probability of at most {_percent(self.met)}, and "
            f"one that holds is called failed with at most {_percent(self.failed)}, {looked}.",
        ]
        if self.verdicts > 1 and self.family:
            found.append(
                f"The probability that one or more of the {self.verdicts:,} verdicts are met wrongly is at most "
                f"{_percent(self.met)}, and that one or more failed wrongly at most {_percent(self.failed)}, by Holm."
            )
        elif self.verdicts > 1:
            count = f"{self.verdicts:,} verdicts"
            found += [
                f"The probability that all {count} are met although one requirement does not hold is at most "
                f"{_percent(self.all_met)}.",
                f"The probability that one or more of the {count} are wrong is at most {_percent(self.any_wrong)}."
                if self.any_wrong < 1
                else f"Of the {count} up to {self.mean_wrong:.3g} are wrong on average: raise the confidence if each "
                "one matters.",
            ]
        if self.measured:
            found.append(
                "Of means this is no proof: it was measured on campaigns that were drawn from real scores of four "
                "traffics (docs/campaigns/sequences.md), and other traffics may be worse. A tracker that is lost in "
                "one run in twenty, and in none of these, is not in it: a share of seeds with `in` is exact there too."
            )
        return found


def levels_of(plan: Plan) -> Levels:
    """The levels of a campaign."""
    errors = [1 - each.confidence for each in plan.keys.require for _ in cases_of(plan, each)]
    greatest, sequential = max(errors, default=0.0), plan.keys.stop == "sequential"
    measured = not sequential and any(each.share is None for each in plan.keys.require)
    family = plan.keys.level == "family"
    total = min(sum(errors), 2 * greatest) if family else sum(errors)
    return Levels(len(errors), greatest, greatest, greatest, min(1.0, total), total, sequential, measured, family)


def _percent(probability: float) -> str:
    return percent(round(probability, 12))
