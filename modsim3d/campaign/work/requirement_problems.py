"""Finds what stands against judging the requirements of a campaign, before its first run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from modsim3d.campaign.keys import TIMES, Requirement
from modsim3d.campaign.plan import CAMERA, SCENE, STATE, TRACKER, Plan, cases_of, groups_of, same, value_of, wanted_of
from modsim3d.campaign.work.row import RECALL, SCORES, SCORES_BY, WORLD_SCORES, is_bounded
from modsim3d.io.validation import nearest, shown
from modsim3d.tracking.scores.breakdown import BINS

Names = Sequence[str]


def _where_problems(requirement: Requirement, where: str, plan: Plan, parts: Mapping[str, Names]) -> Iterator[str]:
    """Problems of values in `where` that no run has: a requirement about no run would never be judged. The argument
    `where` is the place of the requirement in the file, and `parts` the names of the parts of all runs, by what divides
    them."""
    keys, labels = [TRACKER, SCENE, *SCORES_BY, *plan.parameters], [tracker.label for tracker in plan.keys.trackers]
    problems = [
        f"{where}.{key}: there is no tracker '{label}' ({nearest(label, labels)})"
        for key, label in (("of", requirement.of), ("minus", requirement.minus))
        if label is not None and label not in labels
    ]
    if len(groups := groups_of(plan, requirement)) > 1:
        named = " and ".join(groups)
        problems.append(f"{where}.where: {named} each divide the runs, and only one may: leave all but one out")
    for key, values in wanted_of(requirement).items():
        if key not in keys:
            problems.append(f"{where}.where.{key}: is not varied in this campaign ({nearest(key, keys)})")
        elif key in plan.drawn:
            problems.append(f"{where}.where.{key}: is drawn for each traffic seed and selects nothing: leave it out")
        elif not values:
            problems.append(f"{where}.where.{key}: names no value")
        else:
            possible = parts[key] if key in groups else _possible(key, plan)
            names = [str(value) for value in possible]
            missing = [value for value in values if not any(same(other, value) for other in possible)]
            if key in groups:  # YAML reads the name 1 as a number
                missing = [value for value in values if str(value) not in names]
            problems += [
                f"{where}.where.{key}: there is no {shown(value)} ({nearest(str(value), names)})" for value in missing
            ]
    if not problems and not cases_of(plan, requirement):
        problems.append(f"{where}.where: no condition has these values together")
    yield from problems


def _possible(key: str, plan: Plan) -> list[Any]:
    """The values that runs of the campaign have of a key, each once."""
    if key == TRACKER:
        return [tracker.label for tracker in plan.keys.trackers]
    values: list[Any] = []
    for value in (value_of(condition, key) for condition in plan.conditions):
        if not any(same(value, other) for other in values):
            values.append(value)
    return values


def score_problems(requirement: Requirement, where: str) -> Iterator[str]:
    """A score that is not there."""
    score, names = requirement.score, (*SCORES, *WORLD_SCORES, *TIMES, RECALL)
    if score not in names and requirement.known_at_m is None:
        yield f"{where}.score: there is no score '{score}' ({nearest(score, names)})"


def _judging_problems(
    requirement: Requirement, where: str, plan: Plan, divisions: Sequence[Mapping[str, Names]]
) -> Iterator[str]:
    """Scores that a part of a run does not have, parts that a run does not have, and means without bounds. The score
    and the keys of `where` are known; the argument `where` is the place of the requirement in the file."""
    score = requirement.score
    bounded = score in (RECALL, *TIMES) or is_bounded(score, plan.keys.score)
    if plan.keys.stop == "sequential" and requirement.share is None and not bounded:
        yield (
            f"{where}: with stop: sequential a mean needs a score with a least and a greatest value, and {score} has "
            "none: say in which share of traffic seeds it must hold, as in `in: 0.9`, or use stop: once"
        )
    groups = groups_of(plan, requirement)
    for group in groups:
        if score not in SCORES_BY[group]:
            yield f"{where}.score: {score} is not known by {group} (known: {', '.join(SCORES_BY[group])})"
    if score == RECALL and not groups:
        those = ", ".join(group for group, scores in SCORES_BY.items() if RECALL in scores)
        yield f"{where}.score: {score} is known of parts of the runs only: `where` needs one of {those}"
    if len(divisions) < len(plan.conditions):
        return
    cases = cases_of(plan, requirement)
    for part, condition in dict.fromkeys((case.part, case.condition) for case in cases if case.part):
        every = [division.get(part.group, ()) for division in divisions]
        if not any(part.name in names for names in every):
            continue  # `_where_problems` says so, or all runs have it
        whose = f"{where}.where.{part.group}: the {'detector' if part.group == STATE else 'scene'} of condition"
        if part.name not in every[condition]:
            yield f"{whose} {condition} has no {part.group} '{part.name}'"
        elif len(every[condition]) == 1:
            yield f"{whose} {condition} has no other {part.group}: leave it out"


def _lookout_problems(requirement: Requirement, where: str, plan: Plan) -> Iterator[str]:
    """Problems of a lookout requirement, whose unit is an approach."""
    if plan.keys.stop == "sequential":
        yield f"{where}: known_at_m does not go with stop: sequential, for its bounds hold for one look"
    for group in groups_of(plan, requirement):
        yield f"{where}.where.{group}: an approach is no part of its run: give {group} in vary, or leave it out"


def requirement_problems(plan: Plan, divisions: Sequence[Mapping[str, Names]]) -> Iterator[str]:
    """Problems of all requirements, given the names of states and cameras of the conditions that can be run."""
    parts = {**BINS, **{key: sorted({name for names in divisions for name in names[key]}) for key in (STATE, CAMERA)}}
    for place, requirement in enumerate(plan.keys.require):
        where = f"require[{place}]"
        yield from score_problems(requirement, where)
        yield from _where_problems(requirement, where, plan, parts)
        if requirement.known_at_m is not None:
            yield from _lookout_problems(requirement, where, plan)
        else:
            yield from _judging_problems(requirement, where, plan, divisions)
