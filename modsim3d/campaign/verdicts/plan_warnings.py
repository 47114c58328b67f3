"""What a plan can never show, known before its first run."""

from __future__ import annotations

from modsim3d.campaign.file.keys import CampaignKeys, Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import groups_of
from modsim3d.campaign.verdicts.betting import perfect_seeds_needed
from modsim3d.campaign.verdicts.family import at_step, cases_of_all, stepped
from modsim3d.campaign.verdicts.offers import too_few
from modsim3d.campaign.verdicts.proportions import clean_seeds_needed, clean_seeds_needed_sequential
from modsim3d.campaign.verdicts.wording import requirement_text
from modsim3d.campaign.work.score_bounds import facts_of, limits_of


def warnings_of(plan: Plan) -> list[str]:
    """What should be said of the requirements of a plan before it is run, a sentence each."""
    found, cases = [], cases_of_all(plan)

    def reason_at(place: int, taken: int, group: str) -> str:
        return never_met(plan.keys, at_step(plan, place, len(cases), taken), group)

    family = len(cases) * (plan.keys.level == "family")
    reached = stepped(family, lambda each, taken: not reason_at(cases[each][0], taken, cases[each][1].group))
    for place, requirement in enumerate(plan.keys.require):
        if reason := reason_at(place, len(reached), next(iter(groups_of(plan, requirement)), "")):
            text = requirement_text(requirement)
            found.append(f"require[{place}] ({text}) can never be met by this plan: {reason}")
    if plan.keys.require and any(factor.latin_hypercube for factor in plan.keys.vary):
        found.append(
            "latin_hypercube: its points depend on each other, and the bounds of requirements take traffic seeds for "
            "independent. They are usually too wide then, but that is not certain; uniform has independent points"
        )
    if plan.keys.uncertainty == "learned" and any(each.share is None for each in plan.keys.require):
        found.append(
            "uncertainty: learned: a mean is one over all detectors that the labelled set allows, so its interval "
            "becomes narrow with many traffic seeds, however small the set is; a share of seeds with `in` says how "
            "many of these detectors are good enough"
        )
    return found


def never_met(keys: CampaignKeys, requirement: Requirement, group: str, undefined: int = 0) -> str:
    """Why a plan is too small to meet a requirement, whatever its runs give; empty if it is not.

    Args:
        keys: The keys of the campaign.
        requirement: The requirement.
        group: What divides the runs into parts, if it is about one.
        undefined: How many traffic seeds are known to have no value.
    """
    seeds = keys.seeds.traffic - undefined
    least, greatest = limits_of(requirement, keys.score)
    at_least, facts = requirement.at_least is not None, facts_of(requirement.score)
    if facts.managed and requirement.resting_on is None:
        return (
            f"{requirement.score} is a mean over what the tracker manages, and one that gives up improves it: "
            f"`resting_on`, as in `resting_on: 0.8`, says on which share of {facts.basis.of} each run must rest"
        )
    if requirement.threshold > greatest if at_least else requirement.threshold < least:
        return f"{requirement.what} is never {f'above {greatest:g}' if at_least else f'below {least:g}'}"
    if requirement.share is not None:
        return _share_never_met(requirement.share, requirement.confidence, keys.stop, seeds)
    if requirement.threshold == (greatest if at_least else least):
        end = "greatest" if at_least else "least"
        return f"no number of runs shows that a mean is the {end} possible value: ask for a share of seeds with `in`"
    if keys.stop == "once":
        return too_few(requirement, seeds, group)
    asked = requirement.threshold - least if at_least else greatest - requirement.threshold
    needed = perfect_seeds_needed(asked / (greatest - least), requirement.confidence)
    if needed > seeds:
        return (
            f"with stop: sequential it needs {needed:,} traffic seeds even if every score is perfect, and has {seeds:,}"
        )
    return ""


def _share_never_met(share: float, confidence: float, stop: str, seeds: int) -> str:
    if stop == "once":
        needed, next_size = (clean_seeds_needed(share, confidence, failures) for failures in (0, 1))
        if needed > seeds:
            sizes = f"{needed:,} traffic seeds that are all right, or {next_size:,} if one is not"
            return f"it needs {sizes}, and has {seeds:,}"
    elif (needed := clean_seeds_needed_sequential(share, confidence)) > seeds:
        return f"with stop: sequential it needs {needed:,} traffic seeds that are all right, and has {seeds:,}"
    return ""
