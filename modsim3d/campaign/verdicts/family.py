"""Verdicts that together err with no more than the level of one: Holm's step-down."""

from __future__ import annotations

from collections.abc import Callable

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import Case, cases_of


def cases_of_all(plan: Plan) -> list[tuple[int, Case]]:
    """The place of a requirement and a case of it, for each verdict."""
    return [(place, case) for place, each in enumerate(plan.keys.require) for case in cases_of(plan, each)]


def at_step(plan: Plan, place: int, count: int, taken: int) -> Requirement:
    """A requirement with the confidence at which it is judged, as one of `count` of which `taken` are decided."""
    requirement = plan.keys.require[place]
    if plan.keys.level == "each":
        return requirement
    confidence = 1 - (1 - requirement.confidence) / max(1, count - taken)
    return requirement.model_copy(update={"confidence": round(confidence, 12)})


def stepped(count: int, holds: Callable[[int, int], bool]) -> dict[int, int]:
    """Statements, of `count`, that hold together, each with the number of those that held before.

    After Holm (1979), "A simple sequentially rejective multiple test procedure", Scand. J. Stat. 6, 65-70: all are
    tested with α/m; what holds leaves its part to the others, which are tested again with α/(m − k).

    Args:
        count: Their number.
        holds: Whether the one at a place does, when so many others are known to hold.
    """
    found: dict[int, int] = {}
    while new := [place for place in range(count) if place not in found and holds(place, len(found))]:
        found |= dict.fromkeys(new, len(found))
    return found
