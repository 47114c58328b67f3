"""How many traffic seeds each requirement of a plan needs, said before it runs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.campaign.file.keys import MOST_SEEDS, Requirement, Seeds
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import SCENE, Case, cases_of, value_of
from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.results.gather import results_table
from modsim3d.campaign.verdicts.betting import log_capital
from modsim3d.campaign.verdicts.bisection import least_whole
from modsim3d.campaign.verdicts.family import at_step, cases_of_all
from modsim3d.campaign.verdicts.means import corrected_bounds
from modsim3d.campaign.verdicts.offers import offered_from
from modsim3d.campaign.verdicts.plan_warnings import never_met
from modsim3d.campaign.verdicts.proportions import clean_seeds_needed, clean_seeds_needed_sequential
from modsim3d.campaign.verdicts.seed_values import Rows
from modsim3d.campaign.verdicts.wording import counted, requirement_text, rounded
from modsim3d.campaign.work.score_bounds import limits_of
from modsim3d.errors import ModsimError
from modsim3d.inputs.validation import nearest

POWER = 0.8
"""How often a mean as expected is to be met."""
_DRAWN, _DRAWN_SEQUENTIAL, _LONGEST = 20_000, 100, 5_000
_NUMBER = r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"


@dataclass(frozen=True)
class Expected:
    """Expected mean and standard deviation of a score over traffic seeds, and the lost runs that are left out."""

    mean: float
    spread: float
    lost: int = 0


@dataclass(frozen=True)
class NeededSeeds:
    """Number of traffic seeds that a requirement needs.

    Attributes:
        requirement: Its place in the file, from 0.
        text: It in words.
        tracker: Name of the tracker in tables, or of two; None: of all.
        condition: Number of the condition; None: of all.
        seeds: Seeds that it needs; None if none are enough, or if that is unknown.
        why: What that rests on.
        expected: What is expected of its mean; None if unknown, or if it is on a share.
    """

    requirement: int
    text: str
    tracker: str | None
    condition: int | None
    seeds: int | None = None
    why: str = ""
    expected: Expected | None = None


def parsed_expectation(text: str, plan: Plan) -> tuple[str, Expected]:
    """Name and expectation of `SCORE=MEAN:SPREAD` for a required mean; of a difference `SCORE of NEW minus OLD`.

    Raises:
        ModsimError: It says nothing of that kind.
    """
    if not (match := re.fullmatch(rf"(.+)={_NUMBER}:{_NUMBER}", text)):
        raise ModsimError(f"--expect: needs SCORE=MEAN:SPREAD, as in hota=0.7:0.05 (got '{text[:60]}')")
    name, found = match[1], Expected(float(match[2]), float(match[3]))
    if not found.spread > 0:
        raise ModsimError(f"--expect {name}: needs a spread above 0 (got {found.spread:g})")
    known = list(dict.fromkeys(each.what for each in plan.keys.require if each.share is None))
    if name not in known:
        raise ModsimError(f"--expect: no requirement is on the mean of '{name}' ({nearest(name, known)})")
    return name, found


def needed_seeds(plan: Plan, expected: Mapping[str, Expected], like: CampaignFolder | None) -> list[NeededSeeds]:
    """How many seeds each requirement needs, by tracker and condition where these differ.

    Args:
        plan: The plan.
        expected: Name of a score, or of a difference of it → what is expected of it.
        like: An earlier campaign, whose scores are expected where nothing is given.
    """
    rows = None if like is None else Rows(like.plan, results_table(like))
    found = []
    verdicts = len(cases_of_all(plan))
    for place in range(len(plan.keys.require)):
        requirement, each = at_step(plan, place, verdicts, 0), []
        for case in cases_of(plan, requirement):
            known = expected.get(requirement.what)
            if known is None and like is not None and rows is not None:
                known = _seen(plan, case, requirement, like.plan, rows)
            label = " − ".join(_labels(plan, case))
            empty = NeededSeeds(place, requirement_text(requirement, case.within), label, case.condition)
            each.append(_with_seeds(empty, plan, requirement, case, known if requirement.share is None else None))
        if len(each) > 1 and len({(one.seeds, one.why) for one in each}) == 1:
            each = [replace(each[0], tracker=None, condition=None)]
        found += each
    return found


def _labels(plan: Plan, case: Case) -> list[str]:
    return [plan.keys.trackers[each].label for each in (case.tracker, case.minus) if each is not None]


def _with_seeds(
    empty: NeededSeeds, plan: Plan, requirement: Requirement, case: Case, expected: Expected | None
) -> NeededSeeds:
    share, sure, once = requirement.share, requirement.confidence, plan.keys.stop == "once"
    endless = plan.keys.model_copy(update={"seeds": Seeds(traffic=MOST_SEEDS)})
    if reason := never_met(endless, requirement, case.group):
        return replace(empty, why=f"never: {reason}")
    if share is not None and not once:
        return replace(empty, seeds=clean_seeds_needed_sequential(share, sure), why="if all are right")
    if share is not None:
        clean, more = (clean_seeds_needed(share, sure, wrong) for wrong in (0, 1))
        return replace(empty, seeds=clean, why=f"if all are right; {more:,} if one is not")
    least = int(offered_from(requirement, case.group)) if once else 1
    if expected is None:
        why = f"unknown, {least} or more: it needs --expect '{requirement.what}=MEAN:SPREAD', or --like DIR that has it"
        return replace(empty, why=why)
    found = replace(empty, expected=expected)
    if not requirement.holds(expected.mean) or expected.mean == requirement.threshold:
        side = "above" if requirement.at_least is not None else "below"
        said = f"the expected mean, {rounded(expected.mean)}, is not {side} {requirement.threshold:g}"
        return replace(found, why=f"never: {said}")
    if not expected.spread > 0:
        return replace(found, why="never: equal values show nothing of a mean: ask for a share of seeds with `in`")
    seeds = (_once if once else _sequential)(expected, requirement, limits_of(requirement, plan.keys.score), least)
    why = f"for a mean of {rounded(expected.mean)} and a spread of {rounded(expected.spread)}"
    why += f", {counted(expected.lost, 'lost run')} of it left out" * (expected.lost > 0)
    return replace(found, seeds=seeds, why=why if seeds else f"more than {_LONGEST:,} {why}")


def _seen(plan: Plan, case: Case, requirement: Requirement, like: Plan, rows: Rows) -> Expected | None:
    """Mean and spread of an earlier campaign, of the same trackers and values; None with fewer than two seeds."""
    labels, condition = [each.label for each in like.keys.trackers], plan.conditions[case.condition]
    same = [
        place
        for place, each in enumerate(like.conditions)
        if each.values == condition.values and value_of(each, SCENE) == value_of(condition, SCENE)
    ]
    if not same or not set(_labels(plan, case)) <= set(labels):
        return None
    tracker, *minus = (labels.index(each) for each in _labels(plan, case))
    there = Case(tracker, same[0], case.part, *minus)
    runs = rows.runs_of(there, requirement.score, requirement.resting_on)
    means = runs.means(math.nan)
    means = means[np.isfinite(means)]
    return Expected(float(means.mean()), float(means.std(ddof=1)), int(runs.lost.sum())) if len(means) > 1 else None


def _once(expected: Expected, requirement: Requirement, limits: tuple[float, float], least: int) -> int:
    """The least number of normal values with which the bound of a verdict is beyond the threshold with `POWER`."""
    sign = 1 if requirement.at_least is not None else -1
    greatest = limits[1] if sign > 0 else -limits[0]

    def enough(seeds: int) -> bool:
        rng = np.random.default_rng(1)
        mean = sign * expected.mean + expected.spread / math.sqrt(seeds) * rng.standard_normal(_DRAWN)
        skewness = math.sqrt(6 * (seeds - 2) / ((seeds + 1) * (seeds + 3))) * rng.standard_normal(_DRAWN)
        deviation = expected.spread * np.sqrt(rng.chisquare(seeds - 1, _DRAWN) / (seeds - 1))
        mean = np.minimum(mean, np.nextafter(greatest, -math.inf))
        low = corrected_bounds(mean, deviation, skewness, seeds, 1 - requirement.confidence, greatest)
        return float(np.mean(low >= sign * requirement.threshold)) >= POWER

    return least_whole(enough, max(least, 3))


def _sequential(expected: Expected, requirement: Requirement, limits: tuple[float, float], least: int) -> int | None:
    """After how many normal values, cut to what the score can be, `POWER` of the sequences are met."""
    start, end = limits if requirement.at_least is not None else reversed(limits)
    rng, wealth, first = np.random.default_rng(1), -math.log1p(-requirement.confidence), []
    for _ in range(_DRAWN_SEQUENTIAL):
        values = np.clip((rng.normal(expected.mean, expected.spread, _LONGEST) - start) / (end - start), 0, 1)
        met = np.flatnonzero(log_capital(values, (requirement.threshold - start) / (end - start)) >= wealth)
        first.append(max(met[0] + 1, least) if len(met) else math.inf)
    seeds = float(np.quantile(first, POWER, method="inverted_cdf"))
    return int(seeds) if math.isfinite(seeds) else None
