"""What a requirement is about: which trackers, conditions and parts of the runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.conditions import TRACKER, Condition
from modsim3d.campaign.plan.plan import Plan
from modsim3d.tracking.scores.breakdown import BINS

STATE, CAMERA, SCENE = "state", "camera", "scene"
GROUPS = (STATE, CAMERA, *BINS)
"""What divides each run into parts that have scores of their own."""


@dataclass(frozen=True)
class RunPart:
    """A part of each run.

    Attributes:
        group: What divides the runs, one of `GROUPS`.
        name: Of a performance state, a camera, or a bin of the breakdown.
    """

    group: str
    name: str


@dataclass(frozen=True)
class Case:
    """A tracker in a condition: what a requirement is judged for.

    Attributes:
        tracker: Place of the tracker in the file, from 0.
        condition: Number of the condition.
        part: The part of the runs that counts; None: all of them.
        minus: Place of the tracker whose score is taken off; None: of none.
    """

    tracker: int
    condition: int
    part: RunPart | None = None
    minus: int | None = None

    @property
    def group(self) -> str:
        """The property that divides the runs; empty if all of them count."""
        return self.part.group if self.part else ""

    @property
    def within(self) -> str:
        """The part of the runs in words, such as ` in state haze`; empty if all of them count."""
        return f" in {self.part.group} {self.part.name}" if self.part else ""


def cases_of(plan: Plan, requirement: Requirement) -> list[Case]:
    """The cases of a requirement, by tracker, condition and part of the runs.

    A key that is drawn for each traffic seed selects nothing and does not split.
    """
    wanted = wanted_of(requirement)
    labels = wanted.pop(TRACKER, None) if requirement.of is None else [requirement.of]
    named = [RunPart(key, str(name)) for key in groups_of(plan, requirement) for name in wanted.pop(key)]
    parts: list[RunPart | None] = [*dict.fromkeys(named)]
    chosen = [index for index, each in enumerate(plan.conditions) if selects(wanted, each)]
    trackers = [index for index, each in enumerate(plan.keys.trackers) if labels is None or each.label in labels]
    minus = next((index for index, each in enumerate(plan.keys.trackers) if each.label == requirement.minus), None)
    cases = ((tracker, condition) for tracker in trackers for condition in chosen)
    return [Case(*each, part, minus) for each in cases for part in parts or [None]]


def groups_of(plan: Plan, requirement: Requirement) -> list[str]:
    """The keys of `where` that name parts of the runs; a key that is varied selects conditions."""
    return [key for key in GROUPS if key in requirement.where and key not in plan.parameters]


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
