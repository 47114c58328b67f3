"""Verdicts on requirements."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from modsim3d.campaign.keys import CampaignKeys, Requirement
from modsim3d.campaign.plan import SCENE, Case, Plan, labels_of, traffic_seed
from modsim3d.campaign.verdicts import wording
from modsim3d.campaign.verdicts.bounds import UNKNOWN, Bounds, clean_seeds, mean_bounds, mean_share_low, share_bounds
from modsim3d.campaign.verdicts.seed_values import Runs, SeedRows, required_approaches
from modsim3d.campaign.work.row import facts_of, limits_of, without_tracks
from modsim3d.core.text import counted

Outcome = Literal["met", "failed", "undecided"]


@dataclass(frozen=True)
class Verdict:
    """A requirement, judged for one tracker in one condition.

    Attributes:
        requirement: Its place in the file, from 0.
        text: It in words, such as `hota at least 0.6 in state haze`.
        tracker: Name of the tracker in tables.
        condition: Number of the condition.
        values: The values of the varied keys in this condition, without those that are drawn.
        outcome: Whether it is met.
        why: In a sentence, what that rests on.
        confidence: The least probability that the verdict is right if the truth is at the threshold.
        estimate: The mean, or the share of seeds that are right; None if unknown.
        low: The lower end of its interval: what `met` of an `at_least` or of a share is held against; None if unknown.
        high: The upper end.
        seeds: Number of traffic seeds that it rests on.
        crashed: Number of runs that crashed.
        nothing: Number of those in which the tracker gave nothing to score, or too little: they count as crashes do.
        undefined: Number of seeds without a value that are left out: their truth has nothing to score.
        left_out: Number of runs without a value that are left out for the same reason, in seeds that have others.
        rests_on: The share of what is to be followed that the score rests on, mean over runs; None if unknown.
        met_without_tracks: Whether a tracker without any track would have met it too.
    """

    requirement: int
    text: str
    tracker: str
    condition: int
    outcome: Outcome
    why: str
    confidence: float
    estimate: float | None
    low: float | None
    high: float | None
    seeds: int
    crashed: int = 0
    nothing: int = 0
    undefined: int = 0
    left_out: int = 0
    rests_on: float | None = None
    met_without_tracks: bool = False
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def qualified(self) -> bool:
        """Whether there is more to say than its interval does: runs that are missing, or nothing that it takes."""
        return bool(self.crashed or self.nothing or self.undefined or self.left_out or self.met_without_tracks)


NO_TRACKS = "No tracks at all would meet it too: `resting_on` asks for a share of vessel-frames to be followed."
_NAMED = 5  # most seeds without a value that are named


def judge(plan: Plan, table: pa.Table) -> tuple[Verdict, ...]:
    """A verdict for each requirement, tracker and condition that it is about, on the rows before the first traffic seed
    that is not whole. With `stop: once`, every verdict is undecided until all runs are there."""
    rows, cases = SeedRows(plan, table), wording.cases_of_all(plan)
    verdicts = [*_verdicts(plan, rows, cases)]
    for place, case in wording.cases_of_all(plan, of_time=True):
        requirement = plan.keys.require[place]
        verdicts.append((_of_time if requirement.share is None else _verdict)(plan, place, requirement, case, rows))
    return tuple(sorted(verdicts, key=lambda verdict: verdict.requirement))


def repeatable(plan: Plan, verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """The verdicts on scores: those on what runs took are others when a campaign is run again."""
    return tuple(verdict for verdict in verdicts if not plan.keys.require[verdict.requirement].of_time)


def _of_time(plan: Plan, place: int, requirement: Requirement, case: Case, rows: SeedRows) -> Verdict:
    """A verdict on what every run of a campaign took, without any probability: met if all are right."""
    keys, runs = plan.keys, rows.runs_of(case, requirement.score)
    values = runs.values[~np.isnan(runs.values)]
    worst = None if not len(values) else float(values.min() if requirement.at_least is not None else values.max())
    done = rows.seeds == keys.seeds.traffic or keys.stop == "sequential"
    wrong = bool(runs.crashed.any()) or (worst is not None and not requirement.holds(worst))
    outcome: Outcome = "failed" if wrong else "met" if worst is not None and done else "undecided"
    why = f"The worst of {counted(len(values), 'run')} has {wording.rounded(worst)}" if worst is not None else "No run"
    why += " on the machines that made them" if worst is not None else f" has {requirement.score}"
    why += f"; {counted(int(runs.crashed.sum()), 'run')} crashed" * bool(runs.crashed.any())
    why += ". Not repeatable: another run takes another time, and no probability goes with it."
    finding = _Finding(outcome, worst, UNKNOWN, why)
    return _statement(plan, place, requirement, case, finding, rows.seeds, int(runs.crashed.sum()))


def _verdicts(plan: Plan, rows: SeedRows, cases: list[tuple[int, Case]]) -> tuple[Verdict, ...]:
    @cache
    def verdict(index: int, taken: int) -> Verdict:
        place, case = cases[index]
        return _verdict(plan, place, wording.at_step(plan, place, len(cases), taken), case, rows)

    if plan.keys.level == "each":
        return tuple(verdict(index, 0) for index in range(len(cases)))
    met = wording.stepped(len(cases), lambda index, taken: verdict(index, taken).outcome == "met")
    failed = wording.stepped(len(cases), lambda index, taken: verdict(index, taken).outcome == "failed")
    decided, rest = met | failed, min(len(met), len(failed))
    return tuple(
        verdict(index, decided[index]) if index in decided else replace(verdict(index, rest), outcome="undecided")
        for index in range(len(cases))
    )


@dataclass(frozen=True)
class _Finding:
    """Outcome that the rows give, its numbers, and the sentence that states them."""

    outcome: Outcome
    estimate: float | None
    bounds: Bounds
    why: str


def _statement(
    plan: Plan,
    place: int,
    requirement: Requirement,
    case: Case,
    finding: _Finding,
    seeds: int,
    crashed: int,
    **more: Any,
) -> Verdict:
    """The verdict, with `more` of its fields by name."""
    low, high = (bound if math.isfinite(bound) else None for bound in (finding.bounds.low, finding.bounds.high))
    return Verdict(
        place,
        wording.requirement_text(requirement, case.within),
        " − ".join(labels_of(plan, case)),
        case.condition,
        finding.outcome,
        finding.why,
        requirement.confidence,
        finding.estimate,
        low,
        high,
        seeds,
        crashed,
        values=_values(plan, case),
        **more,
    )


def _verdict(plan: Plan, place: int, requirement: Requirement, case: Case, rows: SeedRows) -> Verdict:
    keys = plan.keys
    if requirement.known_at_m is not None:
        return _of_approaches(plan, place, requirement, case, rows)
    runs = rows.runs_of(case, requirement.score, requirement.resting_on)
    group, undefined = case.group, int(runs.undefined.sum())
    of_mean = requirement.share is None
    own = rows.runs_of(replace(case, minus=None), requirement.score, requirement.resting_on)
    finding = _of_mean(requirement, runs, own, keys, group) if of_mean else _of_share(requirement, runs, keys)
    impossible = wording.never_met(keys, requirement, group, undefined)
    if finding.outcome == "met" and impossible:
        finding = replace(finding, outcome="undecided")
    why = [finding.why]
    if keys.stop == "once" and rows.seeds < keys.seeds.traffic:
        finding, why = _not_yet(finding, requirement, runs, keys.seeds.traffic)
    elif finding.outcome == "undecided" and impossible:
        why.append(f"This plan can never meet it: {impossible}.")
    why += _of_lost(runs, requirement, keys)
    why += _of_left_out(runs, requirement, wording.with_name(requirement.what) + case.within, keys.seed)
    facts, rests_on = facts_of(requirement.score, group), runs.rests_on
    if rests_on is not None and (facts.managed or requirement.resting_on is not None):
        less = "" if case.minus is None else ", the less of both trackers"
        why.append(f"It rests on {wording.rounded(100 * rests_on)} % of {facts.basis.of}{less}, mean over runs.")
    if met_without_tracks := _met_without_tracks(requirement, keys, runs, rows, case):
        why.append(NO_TRACKS)
    if keys.level == "family":
        why.append(f"Judged at {wording.percent(requirement.confidence)}, by Holm for all verdicts together.")
    return _statement(
        *(plan, place, requirement, case, replace(finding, why=" ".join(why))),
        int(np.count_nonzero(~runs.undefined)),
        int(runs.crashed.sum()),
        nothing=int(runs.nothing.sum()),
        undefined=undefined,
        left_out=int(runs.left_out.sum()),
        rests_on=rests_on,
        met_without_tracks=met_without_tracks,
    )


def _of_approaches(plan: Plan, place: int, requirement: Requirement, case: Case, rows: SeedRows) -> Verdict:
    """A verdict on the share of approaches that are known, mean over traffic seeds; in one that crashed none is."""
    assert requirement.share is not None
    counts = required_approaches(requirement, *rows.approaches(case))
    bounds, alpha, crashed = UNKNOWN, 1 - requirement.confidence, int(counts.crashed.sum())
    if done := rows.seeds == plan.keys.seeds.traffic and counts.share is not None:
        bounds = Bounds(mean_share_low(counts.shares, alpha), 1 - mean_share_low(1 - counts.shares, alpha))
    outcome = _outcome(bounds.low >= requirement.share, bounds.high < requirement.share)
    why = f"{counts.known.sum():,.0f} of {counts.came.sum():,.0f} approaches are known at {requirement.known_at_m:,g} m"
    why += f" ({counts.appeared_nearer:,} appeared nearer, {counts.never_so_near:,} never came so near)"
    why += f"; mean of {counted(len(counts.shares), 'traffic seed')} that have some" if counts.share is not None else ""
    why += f"{' ' if counts.share is not None else '; '}{_between(bounds, requirement)}." if done else "."
    why += f" {counted(crashed, 'seed')} with a run that crashed: none is known there." if crashed else ""
    why += _false_tracks(plan, rows, case)
    if rows.seeds < plan.keys.seeds.traffic:
        why += f" It is judged when all {plan.keys.seeds.traffic:,} traffic seeds are done."
    return _statement(plan, place, requirement, case, _Finding(outcome, counts.share, bounds, why), rows.seeds, crashed)


def _false_tracks(plan: Plan, rows: SeedRows, case: Case) -> str:
    """Mean number of false tracks in a sentence, which warns if no requirement limits it; empty where none is known."""
    numbers = np.concatenate([rows.columns(case)(f"{where}false_tracks").ravel() for where in ("", "world_")])
    if not np.isfinite(numbers).any():
        return ""
    limited = any("false_track" in requirement.score for requirement in plan.keys.require)
    warning = "" if limited else ": no requirement limits them, and tracks everywhere would find every vessel"
    return f" {np.nanmean(numbers):,.3g} false tracks a run{warning}."


def _not_yet(finding: _Finding, requirement: Requirement, runs: Runs, planned: int) -> tuple[_Finding, list[str]]:
    """Undecided, with the state so far and without bounds, which hold for one look only."""
    done, state = counted(len(runs.values), "traffic seed"), ""
    if finding.estimate is not None:
        right = f"{100 * finding.estimate:.4g} % right"
        state = f", {f'mean {wording.rounded(finding.estimate)}' if requirement.share is None else right} so far"
    why = f"{done} of {planned:,} {'is' if len(runs.values) == 1 else 'are'} done{state}; it is judged when all are."
    return _Finding("undecided", finding.estimate, UNKNOWN, why), [why]


def _of_left_out(runs: Runs, requirement: Requirement, name: str, base: int) -> Iterator[str]:
    """Sentences on the seeds and runs that the truth leaves without a value, with reasons."""
    alone = counted(int(runs.left_out.sum()), "run")
    whole = counted(int(runs.undefined.sum()), "traffic seed")
    for seeds, what in ((runs.undefined, whole), (runs.left_out.any(axis=1), f"{alone} of other traffic seeds")):
        if named := [str(traffic_seed(base, index)) for index in np.flatnonzero(seeds).tolist()]:
            more = ", …" * (len(named) > _NAMED)
            yield f"{what} without {name} left out: {', '.join(named[:_NAMED])}{more}."
    if np.any(runs.undefined) or np.any(runs.left_out):
        clean = " or nothing of that kind went wrong" if facts_of(requirement.score).of_faults else ""
        yield f"The truth has nothing to score there{clean}."


def _met_without_tracks(requirement: Requirement, keys: CampaignKeys, runs: Runs, rows: SeedRows, case: Case) -> bool:
    """Whether the runs would have been right without any track, in a difference of the first tracker."""
    values = without_tracks(requirement.score, keys.score, rows.columns(case))
    at_most = requirement.at_most is not None
    if values is None or requirement.resting_on is not None:
        return False
    if case.minus is not None:
        values = values - rows.runs_of(replace(case, tracker=case.minus, minus=None), requirement.score).values
    if facts_of(requirement.score).without_tracks is None and not at_most:
        return False  # no more than an upper bound is known
    without = replace(runs, values=values, nothing=np.zeros_like(runs.nothing))
    if requirement.share is not None:
        right = without.right(requirement)
        return len(right) > 0 and float(right.mean()) >= requirement.share
    means = without.means(math.nan)
    means = means[~np.isnan(means)]
    return len(means) > 0 and requirement.holds(float(means.mean()))


def _values(plan: Plan, case: Case) -> dict[str, Any]:
    condition = plan.conditions[case.condition]
    scene = {SCENE: Path(condition.scene).stem} if SCENE in plan.parameters else {}
    return {**scene, **condition.values, **({} if case.part is None else {case.group: case.part.name})}


def _of_share(requirement: Requirement, runs: Runs, keys: CampaignKeys) -> _Finding:
    assert requirement.share is not None
    right = runs.right(requirement)
    if not len(right):
        return _Finding("undecided", None, UNKNOWN, "No traffic seed has a value.")
    bounds = share_bounds(right, requirement.confidence, keys.stop)
    outcome = _outcome(bounds.low >= requirement.share, bounds.high < requirement.share)
    good = int(right.sum())
    why = f"{good:,} of {counted(len(right), 'traffic seed')} {'is' if 1 in (good, len(right)) else 'are'} right; "
    why += f"{_between(bounds, requirement)}."
    if outcome == "undecided" and keys.stop == "once" and good > requirement.share * len(right):
        needed = clean_seeds(requirement.share, requirement.confidence, len(right) - good)
        most = f"no more than {len(right) - good:,}" if good < len(right) else "none"
        why += (
            f" It would have taken {needed:,} seeds with {most} wrong. A second campaign, with another `seed`, may err "
            "too, and errors add up: plan both beforehand with half the error each "
            f"(`confidence: {(1 + requirement.confidence) / 2:g}`), or use `stop: sequential`."
        )
    return _Finding(outcome, float(right.mean()), bounds, why)


def _of_mean(requirement: Requirement, runs: Runs, own: Runs, keys: CampaignKeys, group: str) -> _Finding:
    """Outcome for a mean; `own` are the runs of the tracker itself, if they are not those of a difference."""
    limits = least, greatest = limits_of(requirement, keys.score)
    worst, best, seen = runs.means(least), runs.means(greatest), runs.means(math.nan)
    if not len(worst):
        return _Finding("undecided", None, UNKNOWN, "No traffic seed has a value.")
    every = mean_bounds(worst, best, requirement.confidence, keys.stop, limits)
    bounds = wording.offered(every, requirement, len(worst), group) if keys.stop == "once" else every
    if requirement.at_least is not None:
        outcome = _outcome(bounds.low >= requirement.threshold, bounds.high < requirement.threshold)
    else:
        outcome = _outcome(bounds.high <= requirement.threshold, bounds.low > requirement.threshold)
    seen = seen[~np.isnan(seen)]
    estimate = float(seen.mean()) if len(seen) else None
    clean = facts_of(requirement.score).of_faults and runs.undefined.any()  # in these seeds nothing went wrong
    hopeless = own.lost.any() and np.all(np.isnan(own.means(math.nan))) and not clean
    if hopeless or (estimate == math.inf and requirement.at_most is not None):
        outcome = "failed"
    name = wording.with_name(requirement.what)
    phrase = f"the mean is {wording.rounded(estimate)}" if estimate is not None else f"no run has {name}"
    if estimate is not None and runs.lost.any():
        phrase = f"the mean of the {len(seen):,} with a value is {wording.rounded(estimate)}"
    why = f"Over {counted(len(worst), 'traffic seed')} {phrase}"
    if bounds.known:
        why += f"; {_between(bounds, requirement)}."
    elif len(worst) < 2 and estimate is not None:
        why += "; one seed says nothing of how much seeds differ."
    elif not runs.lost.any() and estimate != math.inf and not every.known:
        why += (
            ", the same in each, which says nothing of how much others may differ: ask for a share of seeds with `in`."
        )
    else:
        why += "."
    return _Finding(outcome, estimate, bounds, why)


def _outcome(met: bool, failed: bool) -> Outcome:
    return "met" if met else "failed" if failed else "undecided"


def _between(bounds: Bounds, requirement: Requirement) -> str:
    """Bounds that exist, in words, and how sure each is."""
    sides = []
    if math.isfinite(bounds.low):
        sides.append(f"at least {wording.rounded(bounds.low, math.floor)}")
    if math.isfinite(bounds.high):
        sides.append(f"at most {wording.rounded(bounds.high, math.ceil)}")
    what = "the true mean" if requirement.share is None else "the true share"
    prefix = "each " if len(sides) == 2 else ""
    return f"{what} is {' and '.join(sides)}, {prefix}with {wording.percent(requirement.confidence)} confidence"


def _of_lost(runs: Runs, requirement: Requirement, keys: CampaignKeys) -> Iterator[str]:
    """Sentences on how runs count that crashed, or whose tracker gave nothing to score."""
    least, greatest = limits_of(requirement, keys.score)
    worst = least if requirement.at_least is not None else greatest
    crashed, nothing = int(runs.crashed.sum()), int(runs.nothing.sum())
    parts = [f"{counted(crashed, 'run')} crashed"] if crashed else []
    if nothing:
        too_little = "" if requirement.resting_on is None else " or too little"
        parts.append(f"in {counted(nothing, 'run')} the tracker gave nothing{too_little} to score")
    if not parts:
        return
    text = " and ".join(parts)
    text = text[0].upper() + text[1:] + (", of either tracker" if requirement.of is not None else "")
    kind = "score" if requirement.of is None else "difference"
    if runs.lost[~runs.undefined].all():
        yield f"{text}."
    elif requirement.share is not None:
        yield f"{text}: {'this counts' if crashed + nothing == 1 else 'these count'} as wrong."
    elif math.isfinite(worst):
        yield f"{text}: the bounds take the worst and the best possible {kind} in their place."
    else:
        yield (
            f"{text}, and {wording.with_name(requirement.what)} has no worst possible value to take in their place: "
            "it cannot be met. "
            "With `in` such runs are wrong, and others can be right."
        )
