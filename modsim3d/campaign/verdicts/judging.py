"""Judges the requirements of a campaign on its rows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Indices
from modsim3d.campaign.file.keys import CampaignKeys, Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.seeds import traffic_seed
from modsim3d.campaign.plan.selection import SCENE, STATE, Case, cases_of
from modsim3d.campaign.verdicts.bounds import UNKNOWN, Bounds, mean_bounds, share_bounds
from modsim3d.campaign.verdicts.offers import offered
from modsim3d.campaign.verdicts.plan_warnings import never_met
from modsim3d.campaign.verdicts.proportions import clean_seeds_needed
from modsim3d.campaign.verdicts.seed_values import Rows, Runs
from modsim3d.campaign.verdicts.verdict import Outcome, Verdict
from modsim3d.campaign.verdicts.wording import counted, percent, requirement_text, rounded, rounded_down, rounded_up
from modsim3d.campaign.work.score_bounds import score_bounds

_NAMED = 5
"""Most seeds without a value that are named."""


def judged(plan: Plan, table: pa.Table) -> tuple[Verdict, ...]:
    """A verdict for each requirement, tracker and condition that it is about.

    A campaign with `stop: once` is looked at once: until all its runs are there, every verdict is undecided.

    Args:
        plan: The plan.
        table: The rows so far, see `results_table`; those before the first traffic seed that is not whole count.
    """
    rows = Rows(plan, table)
    return tuple(
        _verdict(plan, place, case, rows)
        for place, requirement in enumerate(plan.keys.require)
        for case in cases_of(plan, requirement)
    )


@dataclass(frozen=True)
class _Found:
    """What the rows say: an outcome, its numbers, and the sentence that gives them."""

    outcome: Outcome
    estimate: float | None
    bounds: Bounds
    why: str


def _verdict(plan: Plan, place: int, case: Case, rows: Rows) -> Verdict:
    requirement, keys = plan.keys.require[place], plan.keys
    runs = rows.runs_of(case, requirement.score)
    crashed, undefined = int(runs.crashed.sum()), np.flatnonzero(runs.undefined)
    state = case.state is not None
    of_mean = requirement.share is None
    found = _of_mean(requirement, runs, keys, state) if of_mean else _of_share(requirement, runs, keys)
    why = [found.why]
    if keys.stop == "once" and rows.seeds < keys.seeds.traffic:
        found, why = _not_yet(found, requirement, runs, keys.seeds.traffic)
    elif found.outcome == "undecided" and (reason := never_met(keys, requirement, state, len(undefined))):
        why.append(f"This plan can never meet it: {reason}.")
    if crashed:
        why.append(_of_crashed(crashed, requirement, score_bounds(requirement.score, keys.score)))
    if len(undefined):
        name = requirement.score if case.state is None else f"{requirement.score} in state {case.state}"
        why.append(_of_undefined(undefined, name, keys.seed))
    low, high = (bound if math.isfinite(bound) else None for bound in (found.bounds.low, found.bounds.high))
    return Verdict(
        place,
        requirement_text(requirement, case.state),
        keys.trackers[case.tracker].label,
        case.condition,
        found.outcome,
        " ".join(why),
        requirement.confidence,
        found.estimate,
        low,
        high,
        len(runs.values) - len(undefined),
        crashed,
        len(undefined),
        _values(plan, case),
    )


def _not_yet(found: _Found, requirement: Requirement, runs: Runs, planned: int) -> tuple[_Found, list[str]]:
    """Undecided, with the state so far and without bounds, which hold for one look only."""
    done, state = counted(len(runs.values), "traffic seed"), ""
    if found.estimate is not None:
        mean = requirement.share is None
        state = f", mean {rounded(found.estimate)} so far" if mean else f", {100 * found.estimate:.4g} % right so far"
    why = f"{done} of {planned:,} {'is' if len(runs.values) == 1 else 'are'} done{state}; it is judged when all are."
    return _Found("undecided", found.estimate, UNKNOWN, why), [why]


def _of_undefined(seeds: Indices, name: str, base: int) -> str:
    named = ", ".join(str(traffic_seed(base, int(index))) for index in seeds[:_NAMED])
    more = ", …" if len(seeds) > _NAMED else ""
    return f"{counted(len(seeds), 'traffic seed')} without {name} left out: {named}{more}."


def _values(plan: Plan, case: Case) -> dict[str, Any]:
    """The values of the varied keys, and the state if it is none of them."""
    condition = plan.conditions[case.condition]
    scene = {SCENE: Path(condition.scene).stem} if SCENE in plan.parameters else {}
    return {**scene, **condition.values, **({} if case.state is None else {STATE: case.state})}


def _of_share(requirement: Requirement, runs: Runs, keys: CampaignKeys) -> _Found:
    assert requirement.share is not None
    right = runs.right(requirement)
    if not len(right):
        return _Found("undecided", None, UNKNOWN, "No traffic seed has a value.")
    bounds = share_bounds(right, requirement.confidence, keys.stop)
    outcome = _outcome(bounds.low >= requirement.share, bounds.high < requirement.share)
    good = int(right.sum())
    why = f"{good:,} of {counted(len(right), 'traffic seed')} {'are' if good != 1 else 'is'} right; "
    why += f"{_between(bounds, requirement)}."
    if outcome == "undecided" and keys.stop == "once" and good > requirement.share * len(right):
        needed = clean_seeds_needed(requirement.share, requirement.confidence, len(right) - good)
        most = f"no more than {len(right) - good:,}" if good < len(right) else "none"
        why += (
            f" It would have taken {needed:,} seeds with {most} wrong. A second campaign, with another `seed`, may err "
            "too, and errors add up: plan both beforehand with half the error each "
            f"(`confidence: {(1 + requirement.confidence) / 2:g}`), or use `stop: sequential`."
        )
    return _Found(outcome, float(right.mean()), bounds, why)


def _of_mean(requirement: Requirement, runs: Runs, keys: CampaignKeys, state: bool) -> _Found:
    limits = least, greatest = score_bounds(requirement.score, keys.score)
    worst, best, seen = runs.means(least), runs.means(greatest), runs.means(math.nan)
    if not len(worst):
        return _Found("undecided", None, UNKNOWN, "No traffic seed has a value.")
    every = mean_bounds(worst, best, requirement.confidence, keys.stop, limits)
    bounds = offered(every, requirement, len(worst), state) if keys.stop == "once" else every
    if requirement.at_least is not None:
        outcome = _outcome(bounds.low >= requirement.threshold, bounds.high < requirement.threshold)
    else:
        outcome = _outcome(bounds.high <= requirement.threshold, bounds.low > requirement.threshold)
    seen = seen[~np.isnan(seen)]
    estimate = float(seen.mean()) if len(seen) else None
    said = f"the mean is {rounded(estimate)}" if estimate is not None else "there is no mean"
    why = f"Over {counted(len(worst), 'traffic seed')} {said}"
    if bounds.known:
        why += f"; {_between(bounds, requirement)}."
    elif len(worst) < 2:
        why += "; one seed says nothing of how much seeds differ."
    elif not runs.crashed.any() and not every.known:
        why += (
            ", the same in each, which says nothing of how much others may differ: ask for a share of seeds with `in`."
        )
    else:
        why += "."
    return _Found(outcome, estimate, bounds, why)


def _outcome(met: bool, failed: bool) -> Outcome:
    return "met" if met else "failed" if failed else "undecided"


def _between(bounds: Bounds, requirement: Requirement) -> str:
    """Which bounds there are, and how sure each is."""
    sides = []
    if math.isfinite(bounds.low):
        sides.append(f"at least {rounded_down(bounds.low)}")
    if math.isfinite(bounds.high):
        sides.append(f"at most {rounded_up(bounds.high)}")
    what = "the true mean" if requirement.share is None else "the true share"
    each = "each " if len(sides) == 2 else ""
    return f"{what} is {' and '.join(sides)}, {each}with {percent(requirement.confidence)} confidence"


def _of_crashed(crashed: int, requirement: Requirement, limits: tuple[float, float]) -> str:
    runs = f"{counted(crashed, 'run')} crashed"
    if requirement.share is not None:
        return f"{runs} and {'counts' if crashed == 1 else 'count'} as wrong."
    worst = limits[0] if requirement.at_least is not None else limits[1]
    if math.isfinite(worst):
        return f"{runs}: the bounds take the worst and the best possible score in their place."
    return f"{runs}, and {requirement.score} has no worst possible value to take in their place: it cannot be met."
