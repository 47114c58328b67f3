"""Requirements, shares and bounds in words."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from modsim3d.campaign.keys import CampaignKeys, Requirement
from modsim3d.campaign.plan import Case, Plan, cases_of, groups_of
from modsim3d.campaign.verdicts.bounds import WHOLE, Bounds, clean_seeds, clean_seeds_sequential, perfect_seeds
from modsim3d.campaign.work.row import SHARES, facts_of, limits_of
from modsim3d.tracking.score_text import COLUMNS

_DIGITS = 4
_NAMES = {key: name.partition(",")[0] for name, key, _ in COLUMNS}


def score_name(column: str) -> str:
    """A score as a table names it, from its column in the results."""
    part, _, key = column.rpartition(".")
    group, _, name = part.partition(".")
    return _NAMES.get(key, key) + (f" in {group} {name}" if group else "")


def with_name(text: str) -> str:
    """Text that begins with the key of a score, with its name, such as HOTA, in place of the key."""
    key, space, rest = text.partition(" ")
    return f"{score_name(key)}{space}{rest}"


def requirement_text(requirement: Requirement, within: str = "") -> str:
    """A requirement in words, such as `hota at least 0.6 in state haze`."""
    if requirement.kind is not None and requirement.known_at_m is not None:
        how = "" if requirement.one_track else " by any tracks"
        share = "" if requirement.share is None else f", in {percent(requirement.share)} of approaches"
        return f"{requirement.kind.text} known at {requirement.known_at_m:,g} m{how}{within}{share}"
    side = "at least" if requirement.at_least is not None else "at most"
    text = f"{requirement.what} {side} {requirement.threshold:.10g}"
    if requirement.resting_on is not None:
        text += f" resting on {percent(requirement.resting_on)}"
    text += within
    return text if requirement.share is None else f"{text}, in {percent(requirement.share)} of traffic seeds"


def percent(share: float) -> str:
    """A share as the user wrote it, in percent."""
    return f"{100 * share:.10g} %"


def rounded(value: float, whole: Callable[[float], int] = round) -> str:
    """A number with four digits; a share near 1 with four digits of what it lacks. `whole` is `math.floor` for a lower
    bound, never above what it is, and `math.ceil` for an upper one."""
    if not math.isfinite(value) or value == 0:
        return f"{value:g}".replace("inf", "∞")
    size = min(abs(value), abs(1 - value) or 1.0) if 0 < value < 1 else abs(value)
    decimals = max(0, _DIGITS - 1 - math.floor(math.log10(size)))
    scale = 10.0**decimals
    near = round(value * scale)
    units = near if math.isclose(near, value * scale, rel_tol=1e-12) else whole(value * scale)
    text = f"{units / scale:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


@dataclass(frozen=True)
class Levels:
    """The greatest probabilities of error of the verdicts of a campaign."""

    verdicts: int  # number: for each requirement one for each tracker, condition and state
    met: float  # that a requirement that does not hold is called met; the greatest of all verdicts
    failed: float  # that a requirement that holds is called failed; the greatest of all verdicts
    all_met: float  # that all are called met although one does not hold: an error of that one, so no greater than `met`
    any_wrong: float  # that one verdict or more is wrong: at most the sum of all (union bound)
    mean_wrong: float  # the sum itself: so many verdicts are wrong at most, in the mean of many such campaigns
    sequential: bool  # whether this holds however often the campaign is looked at; else it is looked at once
    measured: bool  # whether a mean is judged by a bound whose errors were measured and not proved
    family: bool = False  # whether the level is that of all that are met, and of all that failed, by Holm's step-down

    def sentences(self) -> list[str]:
        """The levels in words."""
        if not self.verdicts:
            return []
        looked = "however often the campaign is looked at" if self.sequential else "if the campaign is looked at once"
        looked += ", of means as far as it was measured" if self.measured else ""
        texts = [
            f"A requirement that does not hold is called met with a probability of at most {_percent(self.met)}, and "
            f"one that holds is called failed with at most {_percent(self.failed)}, {looked}."
        ]
        if self.verdicts > 1 and self.family:
            texts.append(
                f"The probability that one or more of the {self.verdicts:,} verdicts are met wrongly is at most "
                f"{_percent(self.met)}, and that one or more failed wrongly at most {_percent(self.failed)}, by Holm."
            )
        elif self.verdicts > 1:
            count = f"{self.verdicts:,} verdicts"
            texts += [
                f"The probability that all {count} are met although one requirement does not hold is at most "
                f"{_percent(self.all_met)}.",
                f"The probability that one or more of the {count} are wrong is at most {_percent(self.any_wrong)}."
                if self.any_wrong < 1
                else f"Of the {count} up to {self.mean_wrong:.3g} are wrong on average: raise the confidence if each "
                "one matters.",
            ]
        if self.measured:
            texts.append(
                "Of means this is no proof: it was measured on campaigns that were drawn from real scores of four "
                "traffics (docs/campaigns/sequences.md), and other traffics may be worse. A tracker that is lost in "
                "one run in twenty, and in none of these, is not in it: a share of seeds with `in` is exact there too."
            )
        return texts


def levels_of(plan: Plan) -> Levels:
    """The levels of a campaign."""
    errors = [1 - plan.keys.require[place].confidence for place, _ in cases_of_all(plan)]
    greatest, sequential = max(errors, default=0.0), plan.keys.stop == "sequential"
    measured = not sequential and any(entry.share is None for entry in plan.keys.require if not entry.of_time)
    family = plan.keys.level == "family"
    total = min(sum(errors), 2 * greatest) if family else sum(errors)
    return Levels(len(errors), greatest, greatest, greatest, min(1.0, total), total, sequential, measured, family)


def _percent(probability: float) -> str:
    return percent(round(probability, 12))


LOW, HIGH = "low", "high"
DIFFERENCE = "difference"  # before the key of a score, with a point: of differences between two trackers
OFFERS = "mean_offers.json"  # beside this file; written by `script/campaign sequences`


@cache
def measured_offers() -> dict[str, Any]:
    """The confidences that were measured, and for each score, bound and confidence the least seeds; None: never."""
    offers: dict[str, Any] = json.loads(files(__package__).joinpath(OFFERS).read_text(encoding="utf-8"))
    return offers


def seeds_needed(column: str, bound: str, confidence: float) -> float:
    """The least number of traffic seeds with a value from which on a bound (`LOW` or `HIGH`) of their mean is given;
    infinite: never. `column` is a key of the scores; with `state.` before it for a state within the runs, and so on.
    Between two confidences that were measured, both must hold, and beyond them nothing is given."""
    offers = measured_offers()
    levels, seeds = offers["confidences"], offers["seeds"].get(column, {}).get(bound)
    if seeds is None or not levels[0] <= confidence <= levels[-1]:
        return math.inf
    above = next(place for place, level in enumerate(levels) if level >= confidence)
    around = seeds[above : above + 1] if levels[above] == confidence else seeds[above - 1 : above + 1]
    return max(math.inf if count is None else count for count in around)


def offered_from(requirement: Requirement, group: str) -> float:
    """Number of seeds from which on the bound that a requirement on a mean is held against is given."""
    bound = LOW if requirement.at_least is not None else HIGH
    return seeds_needed(_column(requirement, group), bound, requirement.confidence)


def offered(bounds: Bounds, requirement: Requirement, seeds: int, group: str) -> Bounds:
    """Bounds of a mean over so many seeds, without those that are not given."""
    column = _column(requirement, group)
    low, high = (seeds_needed(column, bound, requirement.confidence) <= seeds for bound in (LOW, HIGH))
    return Bounds(bounds.low if low else -math.inf, bounds.high if high else math.inf)


def too_few(requirement: Requirement, seeds: int, group: str) -> str:
    """Reason why a mean over so many seeds with a value, looked at once, cannot be met; empty if it can. `group`
    divides the runs into parts, if it is about one."""
    needed = offered_from(requirement, group)
    if needed <= seeds:
        return ""
    side, where = "lower" if requirement.at_least is not None else "upper", f" by {group}" if group else ""
    bound = f"the {side} bound of a mean of {with_name(requirement.what)}{where}"
    if math.isfinite(needed):
        why = "with fewer it errs too often; a share of seeds with `in` is exact"
        return f"{bound} needs {needed:.0f} traffic seeds with a value, and has {seeds}: {why}"
    sure = percent(requirement.confidence)
    instead = " or use `stop: sequential`" if requirement.of is not None and requirement.score in SHARES else ""
    return f"{bound} was not measured to hold with {sure} confidence: ask for a share of seeds with `in`{instead}"


def _column(requirement: Requirement, group: str) -> str:
    return ".".join(filter(None, ["" if requirement.of is None else DIFFERENCE, group, requirement.score]))


def cases_of_all(plan: Plan, *, of_time: bool = False) -> list[tuple[int, Case]]:
    """The place of a requirement and a case of it, for each verdict: those on scores, or those on what runs took, which
    stand apart."""
    required = [(place, entry) for place, entry in enumerate(plan.keys.require) if entry.of_time == of_time]
    return [(place, case) for place, entry in required for case in cases_of(plan, entry)]


def at_step(plan: Plan, place: int, count: int, taken: int) -> Requirement:
    """A requirement with the confidence at which it is judged, as one of `count` of which `taken` are decided."""
    requirement = plan.keys.require[place]
    if plan.keys.level == "each":
        return requirement
    confidence = 1 - (1 - requirement.confidence) / max(1, count - taken)
    return requirement.model_copy(update={"confidence": round(confidence, 12)})


def stepped(count: int, holds: Callable[[int, int], bool]) -> dict[int, int]:
    """Statements, of `count`, that hold together, each with the number of those that held before. `holds` tells whether
    the one at a place does, when so many others are known to hold. After Holm (1979), "A simple sequentially rejective
    multiple test procedure", Scand. J. Stat. 6, 65-70: all are tested with α/m; what holds leaves its part to the
    others, which are tested again with α/(m − k)."""
    steps: dict[int, int] = {}
    while new := [place for place in range(count) if place not in steps and holds(place, len(steps))]:
        steps |= dict.fromkeys(new, len(steps))
    return steps


def warnings_of(plan: Plan) -> list[str]:
    """Warnings about the requirements of a plan before it is run, a sentence each."""
    warnings, cases = [], cases_of_all(plan)

    def reason_at(place: int, taken: int, group: str) -> str:
        return never_met(plan.keys, at_step(plan, place, len(cases), taken), group)

    family = len(cases) * (plan.keys.level == "family")
    reached = stepped(family, lambda index, taken: not reason_at(cases[index][0], taken, cases[index][1].group))
    for place, requirement in enumerate(plan.keys.require):
        if requirement.of_time and requirement.share is None:
            continue
        if reason := reason_at(place, len(reached), next(iter(groups_of(plan, requirement)), "")):
            text = requirement_text(requirement)
            warnings.append(f"require[{place}] ({text}) can never be met by this plan: {reason}")
    if plan.keys.require and any(factor.latin_hypercube for factor in plan.keys.vary):
        warnings.append(
            "latin_hypercube: its points depend on each other, and the bounds of requirements take traffic seeds for "
            "independent. They are usually too wide then, but that is not certain; uniform has independent points"
        )
    if plan.keys.uncertainty == "learned" and any(requirement.share is None for requirement in plan.keys.require):
        warnings.append(
            "uncertainty: learned: a mean is one over all detectors that the labelled set allows, so its interval "
            "becomes narrow with many traffic seeds, however small the set is; a share of seeds with `in` says how "
            "many of these detectors are good enough"
        )
    return warnings


def never_met(keys: CampaignKeys, requirement: Requirement, group: str, undefined: int = 0) -> str:
    """Reason why a plan is too small to meet a requirement, whatever its runs give; empty if it is not. `group` divides
    the runs into parts, if it is about one; `undefined` traffic seeds are known to have no value."""
    seeds = keys.seeds.traffic - undefined
    if requirement.known_at_m is not None:
        assert requirement.share is not None
        return _share_never_met(requirement.share, 1 - WHOLE * (1 - requirement.confidence), "once", seeds)
    least, greatest = limits_of(requirement, keys.score)
    at_least, facts = requirement.at_least is not None, facts_of(requirement.score)
    if facts.managed and requirement.resting_on is None:
        return (
            f"{requirement.score} is a mean over what the tracker manages, and one that gives up improves it: "
            f"`resting_on`, as in `resting_on: 0.8`, says on which share of {facts.basis.of} each run must rest"
        )
    if requirement.threshold > greatest if at_least else requirement.threshold < least:
        return f"{with_name(requirement.what)} is never {f'above {greatest:g}' if at_least else f'below {least:g}'}"
    if requirement.share is not None:
        return _share_never_met(requirement.share, requirement.confidence, keys.stop, seeds)
    if requirement.threshold == (greatest if at_least else least):
        end = "greatest" if at_least else "least"
        return f"no number of runs shows that a mean is the {end} possible value: ask for a share of seeds with `in`"
    if keys.stop == "once":
        return too_few(requirement, seeds, group)
    asked = requirement.threshold - least if at_least else greatest - requirement.threshold
    needed = perfect_seeds(asked / (greatest - least), requirement.confidence)
    if needed > seeds:
        return (
            f"with stop: sequential it needs {needed:,} traffic seeds even if every score is perfect, and has {seeds:,}"
        )
    return ""


def _share_never_met(share: float, confidence: float, stop: str, seeds: int) -> str:
    if stop == "once":
        needed, next_size = (clean_seeds(share, confidence, failures) for failures in (0, 1))
        if needed > seeds:
            sizes = f"{needed:,} traffic seeds that are all right, or {next_size:,} if one is not"
            return f"it needs {sizes}, and has {seeds:,}"
    elif (needed := clean_seeds_sequential(share, confidence)) > seeds:
        return f"with stop: sequential it needs {needed:,} traffic seeds that are all right, and has {seeds:,}"
    return ""
