"""What stands against judging a requirement at all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.conditions import TRACKER
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import SCENE, STATE, cases_of, same, value_of, wanted_of
from modsim3d.campaign.work.row import SCORES
from modsim3d.campaign.work.score_bounds import OF_STATES, is_bounded
from modsim3d.inputs.validation import nearest, shown

if TYPE_CHECKING:
    from modsim3d.campaign.work.checking import ConditionFacts


def where_problems(requirement: Requirement, where: str, plan: Plan, states: set[str]) -> Iterator[str]:
    """What `where` names that no run has: a requirement that is about no run would never be judged.

    Args:
        requirement: The requirement.
        where: Its place in the file.
        plan: The plan.
        states: Names of the performance states of all detectors.
    """
    known, labels = [TRACKER, SCENE, STATE, *plan.parameters], [each.label for each in plan.keys.trackers]
    found = [
        f"{where}.{key}: there is no tracker '{label}' ({nearest(label, labels)})"
        for key, label in (("of", requirement.of), ("minus", requirement.minus))
        if label is not None and label not in labels
    ]
    for key, values in wanted_of(requirement).items():
        if key not in known:
            found.append(f"{where}.where.{key}: is not varied in this campaign ({nearest(key, known)})")
        elif key in plan.drawn:
            found.append(f"{where}.where.{key}: is drawn for each traffic seed and selects nothing: leave it out")
        elif not values:
            found.append(f"{where}.where.{key}: names no value")
        else:
            possible = _possible(key, plan, states)
            names = [str(each) for each in possible]
            missing = [each for each in values if not any(same(other, each) for other in possible)]
            found += [
                f"{where}.where.{key}: there is no {shown(each)} ({nearest(str(each), names)})" for each in missing
            ]
    if not found and not cases_of(plan, requirement):
        found.append(f"{where}.where: no condition has these values together")
    yield from found


def _possible(key: str, plan: Plan, states: set[str]) -> list[Any]:
    """The values that runs of the campaign have of a key, each once."""
    if key == TRACKER:
        return [tracker.label for tracker in plan.keys.trackers]
    if key == STATE and key not in plan.parameters:
        return sorted(states)
    found: list[Any] = []
    for value in (value_of(condition, key) for condition in plan.conditions):
        if not any(same(value, each) for each in found):
            found.append(value)
    return found


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
        if not any(state in each.states for each in facts):
            continue  # `where_problems` says so
        if state not in states:
            yield f"{where}.where.state: the detector of condition {condition} has no state '{state}'"
        elif len(states) == 1:
            yield f"{where}.where.state: the detector of condition {condition} has no other state: leave it out"
