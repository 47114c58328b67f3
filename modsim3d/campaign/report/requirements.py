"""The first section of the page: which requirements are met, and how surely."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Sequence

import numpy as np

from modsim3d.campaign.file.keys import Requirement
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import groups_of
from modsim3d.campaign.report.tables import without_empty
from modsim3d.campaign.report.words import MOST_KEYS, condition_cells, number, shown, varying, with_interval
from modsim3d.campaign.verdicts.verdict import Outcome, Verdict
from modsim3d.campaign.verdicts.wording import percent, requirement_text
from modsim3d.display import counted
from modsim3d.view.pages import page
from modsim3d.view.pages.intervals import Interval, span_of, strip

SIGNS: dict[Outcome, str] = {"met": "✓ met", "failed": "✗ failed", "undecided": "? undecided"}
ORDER: tuple[Outcome, ...] = ("failed", "undecided", "met")
OFTEN_EMPTY = ("crashed runs", "runs with nothing to score", "seeds without a value")
"""Columns that are left out where they say nothing."""
MOST_OPEN, MOST_ROWS = 12, 200
"""Verdicts on a requirement that are shown at once, and at all."""


def outcome_of(verdicts: Sequence[Verdict]) -> Outcome:
    """The outcome of a requirement: failed if one of its verdicts is, met if all are."""
    found = {each.outcome for each in verdicts}
    return next((outcome for outcome in ORDER if outcome in found), "undecided")


def verdict_sentence(plan: Plan, verdicts: Sequence[Verdict]) -> str:
    """What the requirements come to, in a sentence."""
    if not plan.keys.require:
        return "This campaign has no requirements: it compares, and decides nothing."
    by_requirement = _by_requirement(plan, verdicts)
    count = Counter(outcome_of(found) for found in by_requirement)
    total = len(by_requirement)
    how = f"at {confidences(plan)} confidence {'each' if plan.keys.level == 'each' else 'together'}"
    sign = {"failed": "✗", "undecided": "?", "met": "✓"}[next(each for each in ORDER if count[each])]
    if count["met"] == total:
        one = "The requirement is" if total == 1 else f"All {total} requirements are"
        return f"{sign} {one} met, {how}."
    lead = "Not met" if count["failed"] else "Not decided"
    if total in count.values():
        subject = "the requirement" if total == 1 else f"all {total} requirements"
        return f"{sign} {lead}: {subject} {_told(total, next(iter(count)))}, {how}."
    parts = [f"{count[outcome]} {_told(count[outcome], outcome)}" for outcome in ORDER if count[outcome]]
    return f"{sign} {lead}: of {total} requirements {', '.join(parts[:-1])} and {parts[-1]}, {how}."


def confidences(plan: Plan) -> str:
    """The confidence of the requirements, or their range."""
    found = sorted({100 * each.confidence for each in plan.keys.require})
    ends = dict.fromkeys(f"{value:g} %" for value in (found[0], found[-1]))
    return " to ".join(ends)


def requirement_sections(plan: Plan, verdicts: Sequence[Verdict]) -> list[str]:
    """Each requirement with its verdicts, and their intervals against the threshold: first what is not met."""
    said = "Each end of an interval holds by itself, with the confidence of the requirement; dashed is the threshold."
    parts = [page.paragraph(said, "soft")]
    by_requirement = _by_requirement(plan, verdicts)
    for place in sorted(range(len(by_requirement)), key=lambda each: ORDER.index(outcome_of(by_requirement[each]))):
        found = by_requirement[place]
        requirement = plan.keys.require[place]
        text = ", ".join([requirement_text(requirement), *_where(plan, requirement)])
        count = Counter(each.outcome for each in found)
        said = SIGNS[outcome_of(found)]
        if len(count) > 1:
            said += f" ({', '.join(f'{count[outcome]} {outcome}' for outcome in ORDER if count[outcome])})"
        elif len(found) > 1:
            said += " in both cases" if len(found) == 2 else f" in all {len(found):,} cases"
        bad = ' class="bad"' if count["failed"] else ""
        parts.append(f"<h3>{place + 1}. {html.escape(text)}: <span{bad}>{html.escape(said)}</span></h3>")
        parts += _table(plan, plan.keys.require[place], found)
    return parts


def _table(plan: Plan, requirement: Requirement, found: Sequence[Verdict]) -> list[str]:
    ordered = sorted(found, key=lambda each: ORDER.index(each.outcome))
    shown = ordered[:MOST_ROWS]
    limit, least = _limit(requirement)
    span = span_of([limit, *(_or_nan(value) for each in shown for value in (each.estimate, each.low, each.high))])
    what = "mean"
    if requirement.share is not None:
        what, span = "share of seeds", (max(0.0, span[0]), min(1.0, span[1]))
    keys = varying(plan)
    groups = groups_of(plan, requirement)
    columns = [*(keys if len(keys) <= MOST_KEYS else ["condition"]), *groups]
    levels = ", ".join(dict.fromkeys(percent(each.confidence) for each in shown)) or percent(requirement.confidence)
    interval = f"{what} [interval, each end {levels}]"
    header = ("tracker", *columns, "outcome", interval, _axis(limit, least, span), *OFTEN_EMPTY, "seeds")
    rows = [_row(each, plan, keys, groups, limit, least, span) for each in shown]
    kept, names = without_empty(rows, header, OFTEN_EMPTY)
    bad = {place for place, each in enumerate(shown) if each.outcome == "failed"}
    notes = {place: _note(each, limit) for place, each in enumerate(shown)}
    table = page.table(kept, names, markup=(len(columns) + 3,), bad=bad, notes=notes)
    if len(rows) > MOST_OPEN:
        first = sum(each.outcome != "met" for each in shown)
        opened = 0 < first <= MOST_OPEN
        table = page.folded(f"All {counted(len(rows), 'verdict')}, failed ones first", table, opened=opened)
    elif all(each.outcome == "met" for each in found):
        table = page.folded(f"{counted(len(rows), 'verdict')}, all met", table)
    parts = [table]
    if len(ordered) > MOST_ROWS:
        parts.append(page.paragraph(f"{len(ordered) - MOST_ROWS:,} more verdicts are in verdicts.json.", "soft"))
    return parts


def _row(
    each: Verdict,
    plan: Plan,
    keys: Sequence[str],
    groups: Sequence[str],
    limit: float,
    least: bool,
    span: tuple[float, float],
) -> tuple[str, ...]:
    values = (_or_nan(each.estimate), _or_nan(each.low), _or_nan(each.high))
    said = with_interval(each.estimate, *values[1:])
    return (
        each.tracker,
        *condition_cells(plan, each.condition, keys),
        *(str(each.values[group]) for group in groups),
        SIGNS[each.outcome],
        said,
        strip(Interval(*values), limit, least, span, f"{said} against {number(limit)}"),
        f"{each.crashed:,}",
        f"{each.nothing:,}",
        f"{each.undefined:,}",
        f"{each.seeds:,}",
    )


def _note(each: Verdict, limit: float) -> str:
    """Why a verdict is what it is, where that is more than its interval says as printed."""
    if each.qualified or each.low is None or each.high is None:
        return each.why
    return each.why if number(limit) in with_interval(each.estimate, each.low, each.high) else ""


def _where(plan: Plan, requirement: Requirement) -> list[str]:
    """The trackers, conditions and parts of the runs that a requirement is about, if not all."""
    given = {key: value if isinstance(value, list) else [value] for key, value in requirement.where.items()}
    return [f"{key} {' or '.join(map(shown, values))}" for key, values in given.items()]


def _limit(requirement: Requirement) -> tuple[float, bool]:
    """What the interval is held against, and whether it must lie above."""
    if requirement.share is not None:
        return requirement.share, True
    return requirement.threshold, requirement.at_least is not None


def _axis(limit: float, least: bool, span: tuple[float, float]) -> str:
    side = "at least" if least else "at most"
    return f"{number(span[0])} to {number(span[1])}; shaded: {side} {number(limit)}"


def _by_requirement(plan: Plan, verdicts: Sequence[Verdict]) -> list[list[Verdict]]:
    found: list[list[Verdict]] = [[] for _ in plan.keys.require]
    for each in verdicts:
        found[each.requirement].append(each)
    return found


def _told(count: int, outcome: Outcome) -> str:
    return "failed" if outcome == "failed" else f"{'is' if count == 1 else 'are'} {outcome}"


def _or_nan(value: float | None) -> float:
    return np.nan if value is None or np.isinf(value) else value
