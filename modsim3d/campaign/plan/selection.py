"""What a requirement is about: which trackers, conditions and performance states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.conditions import TRACKER, Condition
from modsim3d.campaign.plan.plan import Plan

STATE, SCENE = "state", "scene"


@dataclass(frozen=True)
class Case:
    """A tracker in a condition: what a requirement is judged for.

    Attributes:
        tracker: Place of the tracker in the file, from 0.
        condition: Number of the condition.
        state: The performance state whose frames count; None: all frames.
        minus: Place of the tracker whose score is taken off; None: of none.
    """

    tracker: int
    condition: int
    state: str | None = None
    minus: int | None = None


def cases_of(plan: Plan, requirement: Requirement) -> list[Case]:
    """The cases of a requirement, by tracker, condition and state.

    A key that is drawn for each traffic seed selects nothing and does not split.
    """
    wanted = wanted_of(requirement)
    labels = wanted.pop(TRACKER, None) if requirement.of is None else [requirement.of]
    states: list[Any] = [None]
    if STATE not in plan.parameters:
        states = wanted.pop(STATE, states)
    chosen = [index for index, each in enumerate(plan.conditions) if selects(wanted, each)]
    trackers = [index for index, each in enumerate(plan.keys.trackers) if labels is None or each.label in labels]
    minus = next((index for index, each in enumerate(plan.keys.trackers) if each.label == requirement.minus), None)
    return [Case(tracker, condition, state, minus) for tracker in trackers for condition in chosen for state in states]


def wanted_of(requirement: Requirement) -> dict[str, list[Any]]:
    """The values that each key of `where` may have, each once."""
    given = {key: value if isinstance(value, list) else [value] for key, value in requirement.where.items()}
    return {
        key: [each for place, each in enumerate(values) if not any(same(each, other) for other in values[:place])]
        for key, values in given.items()
    }


def selects(wanted: dict[str, list[Any]], condition: Condition) -> bool:
    """Whether a condition has one of the values of each key."""
    return all(any(same(value_of(condition, key), each) for each in values) for key, values in wanted.items())


def same(value: Any, wanted: Any) -> bool:
    """Whether two values of a key are equal: 1 and 1.0 are, 1 and true are not."""
    return bool(value == wanted) and isinstance(value, bool) == isinstance(wanted, bool)


def value_of(condition: Condition, key: str) -> Any:
    """The value that a condition has of a key, or the name of its scene; None if it has none."""
    return Path(condition.scene).stem if key == SCENE else condition.values.get(key)
