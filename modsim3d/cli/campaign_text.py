"""Texts of the commands for campaigns: a plan, verdicts, means and crashed runs, in words and tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.core.text import counted, listed
from modsim3d.io.validation import shown

if TYPE_CHECKING:
    from modsim3d.campaign.keys import CampaignKeys, Factor, Range, Requirement
    from modsim3d.campaign.verdicts.verdict import Verdict
    from modsim3d.campaign.work.checking import CheckedCampaign

UNKNOWN = "–"
MAX_ROWS = 40
"""Rows of a table that the end of a campaign shows."""
MAX_ERRORS = 5
STYLES = {"met": "green", "failed": "bold red", "undecided": "yellow"}
FIRST = ("failed", "undecided", "met")
"""The order in which verdicts are looked at."""


def plan_rows(campaign: CheckedCampaign) -> list[tuple[str, str]]:
    """A campaign before it starts: what is run, and what must hold."""
    plan, keys = campaign.plan, campaign.file.keys
    rows = [("scenes", _scenes(campaign))]
    rows += [("varied" if place == 0 else "", text) for place, text in enumerate(_varied(keys))]
    if keys.settings:
        rows.append(("set", ", ".join(f"{key} {shown(value)}" for key, value in keys.settings.items())))
    rows.append(("trackers", listed([each.label for each in keys.trackers])))
    if keys.search is not None:
        return [*rows, ("search", _search(keys))]
    rows.append(("seeds", _seeds(keys)))
    product = [
        counted(len(plan.conditions), "condition"),
        counted(keys.seeds.traffic, "traffic seed"),
        *([counted(keys.seeds.detector, "detector seed")] if keys.seeds.detector > 1 else []),
        counted(len(keys.trackers), "tracker"),
    ]
    rows.append(("runs", f"{'at most ' * (keys.stop == 'sequential')}{len(plan):,} = {' × '.join(product)}"))
    required = [requirement_in_words(each) for each in keys.require] or ["nothing"]
    return [*rows, *(("required" if place == 0 else "", text) for place, text in enumerate(required))]


def _scenes(campaign: CheckedCampaign) -> str:
    names = {Path(condition.scene).stem: facts for condition, facts in _pairs(campaign)}
    said = [name if facts.traffic_has_seed else f"{name} (this traffic only)" for name, facts in names.items()]
    steps = campaign.file.keys.steps
    return listed(said) + ("" if steps is None else f", {counted(steps, 'step')}")


def _pairs(campaign: CheckedCampaign) -> Iterable[tuple[Any, Any]]:
    return zip(campaign.plan.conditions, campaign.facts, strict=True)


def traffic_warnings(campaign: CheckedCampaign) -> list[str]:
    """Scenes whose results are of one traffic only."""
    fixed = dict.fromkeys(Path(each.scene).stem for each, facts in _pairs(campaign) if not facts.traffic_has_seed)
    if not fixed:
        return []
    traffic = "the traffic of each" if len(fixed) > 1 else "the traffic"
    return [
        f"{listed(list(fixed))}: {traffic} is the same with every seed, so the results "
        "hold for this traffic only; seeds change waves and detections, and fairway draws its traffic"
    ]


def _varied(keys: CampaignKeys) -> list[str]:
    return [text for factor in keys.vary for text in _factor(factor)] or ["nothing"]


def _factor(factor: Factor) -> list[str]:
    ranges = factor.latin_hypercube or factor.uniform
    if ranges is not None:
        how = "drawn for each traffic seed" + (", Latin hypercube" if factor.latin_hypercube else "")
        return [f"{key}: {_range(each)}, {how}" for key, each in ranges.items()]
    if factor.conditions is not None:
        return [f"{counted(len(factor.conditions), 'condition')} of {listed(list(_keys(factor.conditions)))}"]
    together = " (together)" if factor.pairs else ""
    return [f"{key}: {listed([_plain(value) for value in values])}{together}" for key, values in _lists(factor).items()]


def _lists(factor: Factor) -> Mapping[str, Sequence[Any]]:
    return factor.grid or factor.pairs or {}


def _keys(conditions: Iterable[Mapping[str, Any]]) -> dict[str, None]:
    return dict.fromkeys(key for values in conditions for key in values)


def _range(values: Range) -> str:
    if values.choices is not None:
        return f"one of {listed([_plain(value) for value in values.choices])}"
    kinds = [kind for kind in ("whole" * values.whole, "log scale" * (values.scale == "log")) if kind]
    return f"{values.low:g} to {values.high:g}" + (f" ({', '.join(kinds)})" if kinds else "")


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else shown(value)


def _seeds(keys: CampaignKeys) -> str:
    from modsim3d.campaign.plan import traffic_seed

    first, last = traffic_seed(keys.seed, 0), traffic_seed(keys.seed, keys.seeds.traffic - 1)
    said = f"traffic {first}" + (f" to {last}" if last > first else "")
    return said + (f", and {keys.seeds.detector} of the detector for each" if keys.seeds.detector > 1 else "")


def _search(keys: CampaignKeys) -> str:
    search = keys.search
    assert search is not None
    goal = f"lowest {search.minimise}" if search.minimise else f"highest {search.maximise}"
    over = "; ".join(f"{key} {_range(each)}" for key, each in search.over.items())
    return f"the {goal} in {search.budget:,} trials, over {over}"


def requirement_in_words(requirement: Requirement) -> str:
    """A requirement of a campaign file in words."""
    from modsim3d.campaign.verdicts.wording import percent, requirement_text

    where = ", ".join(
        f"{key} {' or '.join(map(_plain, value)) if isinstance(value, list) else _plain(value)}"
        for key, value in requirement.where.items()
    )
    text = requirement_text(requirement) if requirement.share is not None else f"mean {requirement_text(requirement)}"
    return f"{text}{f', where {where}' if where else ''} ({percent(requirement.confidence)} confidence)"


def about_text(verdict: Verdict) -> str:
    """Subject of a verdict, in a few words."""
    from modsim3d.campaign.plan import values_text

    about = ", ".join(filter(None, [verdict.tracker, values_text(verdict.values) if verdict.values else ""]))
    return f"{verdict.text} ({about})"


def duration_text(seconds: float | None) -> str:
    """A time that something will take."""
    if seconds is None:
        return "time left unknown"
    if seconds < 90:
        return f"{max(1, round(seconds))} s left"
    minutes = round(seconds / 60)
    return f"{minutes} min left" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min left"
