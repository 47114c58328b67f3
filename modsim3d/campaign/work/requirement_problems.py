"""What stands against judging a requirement at all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import cases_of
from modsim3d.campaign.work.row import SCORES
from modsim3d.campaign.work.score_bounds import OF_STATES, is_bounded

if TYPE_CHECKING:
    from modsim3d.campaign.work.checking import ConditionFacts


def judging_problems(
    requirement: Requirement, where: str, plan: Plan, facts: Sequence[ConditionFacts]
) -> Iterator[str]:
    """Scores that a state does not have, states that a detector does not have, and means without bounds.

    Args:
        requirement: The requirement; its score and the keys of `where` are known.
        where: Its place in the file.
        plan: The plan.
        facts: What is known of each condition.
    """
    score = requirement.score
    bounded = score not in SCORES or is_bounded(score, plan.keys.score)
    if plan.keys.stop == "sequential" and requirement.share is None and not bounded:
        yield (
            f"{where}: with stop: sequential a mean needs a score with a least and a greatest value, and {score} has "
            "none: say in which share of traffic seeds it must hold, as in `in: 0.9`, or use stop: once"
        )
    cases = [case for case in cases_of(plan, requirement) if case.state is not None]
    if cases and score not in OF_STATES:
        yield f"{where}.score: {score} is not known of a state within a run, only {', '.join(OF_STATES)} are"
    if len(facts) < len(plan.conditions):
        return
    for state, condition in dict.fromkeys((str(case.state), case.condition) for case in cases):
        states = facts[condition].states
        if state not in states:
            yield f"{where}.where.state: the detector of condition {condition} has no state '{state}'"
        elif len(states) == 1:
            yield f"{where}.where.state: the detector of condition {condition} has no other state: leave it out"
