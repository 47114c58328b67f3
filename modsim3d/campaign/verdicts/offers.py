"""From how many traffic seeds on a mean is judged: those from which on its bounds were measured to hold."""

from __future__ import annotations

import json
import math
from functools import cache
from importlib.resources import files
from typing import Any

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.verdicts.bounds import Bounds
from modsim3d.campaign.verdicts.wording import percent
from modsim3d.campaign.work.score_bounds import SHARES

LOW, HIGH = "low", "high"
DIFFERENCE = "difference"
"""Before the key of a score, with a point: of differences between two trackers."""
OFFERS = "mean_offers.json"
"""Beside this file; written by `script/campaign sequences`."""


@cache
def measured_offers() -> dict[str, Any]:
    """The confidences that were measured, and for each score, bound and confidence the least seeds; None: never."""
    found: dict[str, Any] = json.loads(files(__package__).joinpath(OFFERS).read_text(encoding="utf-8"))
    return found


def seeds_needed(column: str, bound: str, confidence: float) -> float:
    """The least number of traffic seeds with a value from which on a bound of their mean is given; infinite: never.

    Args:
        column: A key of the scores; with `state.` before it for a state within the runs, and so on.
        bound: `LOW` or `HIGH`.
        confidence: The confidence; between two that were measured, both must hold, and beyond them nothing is given.
    """
    offers = measured_offers()
    levels, seeds = offers["confidences"], offers["seeds"].get(column, {}).get(bound)
    if seeds is None or not levels[0] <= confidence <= levels[-1]:
        return math.inf
    above = next(place for place, level in enumerate(levels) if level >= confidence)
    around = seeds[above : above + 1] if levels[above] == confidence else seeds[above - 1 : above + 1]
    return max(math.inf if each is None else each for each in around)


def offered_from(requirement: Requirement, group: str) -> float:
    """From how many seeds on the bound that a requirement on a mean is held against is given."""
    bound = LOW if requirement.at_least is not None else HIGH
    return seeds_needed(_column(requirement, group), bound, requirement.confidence)


def offered(bounds: Bounds, requirement: Requirement, seeds: int, group: str) -> Bounds:
    """Bounds of a mean over so many seeds, without those that are not given."""
    column = _column(requirement, group)
    low, high = (seeds_needed(column, bound, requirement.confidence) <= seeds for bound in (LOW, HIGH))
    return Bounds(bounds.low if low else -math.inf, bounds.high if high else math.inf)


def too_few(requirement: Requirement, seeds: int, group: str) -> str:
    """Why a mean over so many seeds, looked at once, cannot be met; empty if it can.

    Args:
        requirement: The requirement.
        seeds: The seeds with a value.
        group: What divides the runs into parts, if it is about one.
    """
    needed = offered_from(requirement, group)
    if needed <= seeds:
        return ""
    side, where = "lower" if requirement.at_least is not None else "upper", f" by {group}" if group else ""
    bound = f"the {side} bound of a mean of {requirement.what}{where}"
    if math.isfinite(needed):
        why = "with fewer it errs too often; a share of seeds with `in` is exact"
        return f"{bound} needs {needed:.0f} traffic seeds with a value, and has {seeds}: {why}"
    sure = percent(requirement.confidence)
    instead = " or use `stop: sequential`" if requirement.of is not None and requirement.score in SHARES else ""
    return f"{bound} was not measured to hold with {sure} confidence: ask for a share of seeds with `in`{instead}"


def _column(requirement: Requirement, group: str) -> str:
    return ".".join(filter(None, ["" if requirement.of is None else DIFFERENCE, group, requirement.score]))
