"""Names of scores, conditions and numbers on the page."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.campaign.folder import FILE, CampaignFolder, files_of_campaign
from modsim3d.campaign.keys import Requirement
from modsim3d.campaign.plan import Plan, groups_of, key_columns, text_of, value_cells, value_text
from modsim3d.campaign.verdicts.seed_values import columns_of
from modsim3d.campaign.verdicts.verdict import Outcome, Verdict, repeatable
from modsim3d.campaign.verdicts.wording import percent, requirement_text, score_name, with_name
from modsim3d.campaign.work.row import SHARES, facts_of
from modsim3d.campaign.work.task import PLAN
from modsim3d.core.document import Block, Cell, Fold, Heading, Row, Table, Text, Where
from modsim3d.core.text import counted, three_digits, three_digits_with_interval
from modsim3d.view.pages.charts import ChartInterval, span_of, strip
from modsim3d.view.pages.provenance import Input, Provenance, file_input, folder_input, versions_in_words

USUAL = "hota"
UNITS = {  # ends of keys, and the units that they stand for
    "_px": "px",
    "_s": "s",
    "_per_s": "1/s",
    "_per_hour": "1/h",
    "_m": "m",
    "_m_s": "m/s",
    "_rad": "rad",
    "_deg": "°",
    "_hz": "Hz",
}


@dataclass(frozen=True)
class Score:
    """A score that the page shows."""

    column: str  # in the results
    requirements: tuple[Requirement, ...] = ()  # those that it is held against

    @property
    def key(self) -> str:
        """Its key, without the part of the runs that it is of."""
        return self.column.rpartition(".")[2]

    @property
    def name(self) -> str:
        """Its name in a table."""
        return score_name(self.column)

    @property
    def label(self) -> str:
        """Its name on an axis, with its unit."""
        unit = "0 to 1" if self.key in SHARES else "px" if self.key.startswith(("gospa", "ospa")) else unit_of(self.key)
        return f"{self.name} ({unit})" if unit else self.name

    @property
    def lowest_is_worst(self) -> bool:
        """Whether low values are the bad ones, by the requirements, or else by what the score is."""
        if self.requirements:
            return self.requirements[0].at_least is not None
        return (self.key in SHARES and not facts_of(self.key).low_is_good) or self.key == "mota"

    @property
    def threshold_words(self) -> list[tuple[str, float]]:
        """Thresholds for its mean, in words and as numbers."""
        sides = {(requirement.threshold, requirement.at_least is not None) for requirement in self._of_mean}
        return [(f"at {'least' if least else 'most'} {value:g}", value) for value, least in sorted(sides)]

    @property
    def thresholds(self) -> tuple[float, ...]:
        """Thresholds for its mean, ascending."""
        return tuple(sorted({requirement.threshold for requirement in self._of_mean}))

    @property
    def _of_mean(self) -> list[Requirement]:
        return [requirement for requirement in self.requirements if requirement.share is None]


def unit_of(key: str) -> str:
    """The unit that the end of a key names; empty without one."""
    return next((unit for end, unit in sorted(UNITS.items(), key=lambda pair: -len(pair[0])) if key.endswith(end)), "")


def axis_of(key: str) -> str:
    """The name of a varied key on an axis, with its unit."""
    unit = unit_of(key)
    return f"{key} ({unit})" if unit else key


def required_scores(plan: Plan) -> list[Score]:
    """The scores that requirements are about, in their order; HOTA if there are none."""
    by_column: dict[str, list[Requirement]] = {}
    for requirement in (requirement for requirement in plan.keys.require if requirement.known_at_m is None):
        for column in columns_of(plan, requirement) or [requirement.score]:
            by_column.setdefault(column, []).extend([requirement] * (requirement.of is None))
    return [Score(column, tuple(group)) for column, group in by_column.items()] or [Score(USUAL)]


def varying(plan: Plan) -> list[str]:
    """The keys that differ between conditions, `scene` among them."""
    rows = [values_of(plan, place) for place in range(len(plan.conditions))]
    keys = dict.fromkeys(key for row in rows for key in row)
    return [key for key in keys if len({text_of(row.get(key)) for row in rows}) > 1]


def constant(plan: Plan) -> dict[str, str]:
    """The keys that are set and the same in all conditions."""
    differing, first = {*varying(plan), "scene"}, {**plan.conditions[0].fixed, **values_of(plan, 0)}
    return {key: value_text(value) for key, value in first.items() if key not in differing}


def values_of(plan: Plan, place: int) -> dict[str, Any]:
    """The scene and the values of a condition that are not drawn."""
    condition = plan.conditions[place]
    return {"scene": Path(condition.scene).stem, **condition.values}


def condition_cells(plan: Plan, place: int, keys: Sequence[str]) -> list[str]:
    """The values of some keys in a condition, as cells of a table; one cell if there are many keys."""
    return value_cells(values_of(plan, place), keys)


def without_empty(rows: Sequence[Row], header: Sequence[str], empty: Sequence[str]) -> tuple[list[Row], list[str]]:
    """Rows and header without those of some columns in which no row says anything: all cells are empty or 0."""
    full = [name not in empty or any(row[place] not in ("", "0") for row in rows) for place, name in enumerate(header)]
    kept = [place for place, flag in enumerate(full) if flag]
    return [[row[place] for place in kept] for row in rows], [header[place] for place in kept]


SIGNS: dict[Outcome, str] = {"met": "✓ met", "failed": "✗ failed", "undecided": "? undecided"}
ORDER: tuple[Outcome, ...] = ("failed", "undecided", "met")
OFTEN_EMPTY = ("crashed runs", "runs with nothing to score", "seeds without a value")  # left out if they say nothing
MAX_OPEN, MAX_ROWS = 12, 200  # verdicts on a requirement that are shown at once, and at all


def outcome_of(verdicts: Sequence[Verdict]) -> Outcome:
    """The outcome of a requirement: failed if one of its verdicts is, met if all are."""
    outcomes = {verdict.outcome for verdict in verdicts}
    return next((outcome for outcome in ORDER if outcome in outcomes), "undecided")


def verdict_sentence(plan: Plan, verdicts: Sequence[Verdict]) -> str:
    """Summary of the verdicts, in a sentence."""
    if not plan.keys.require:
        return "This campaign has no requirements: it compares, and decides nothing."
    if own := repeatable(plan, verdicts):
        return _verdict_sentence(plan, own) + "".join(f" {text}" for text in [_took_sentence(plan, verdicts)] if text)
    return _took_sentence(plan, verdicts)


def _took_sentence(plan: Plan, verdicts: Sequence[Verdict]) -> str:
    """Summary of the verdicts on what runs took; empty without any."""
    count = Counter(verdict.outcome for verdict in verdicts if plan.keys.require[verdict.requirement].of_time)
    parts = ", ".join(f"{count[outcome]} {_verb(count[outcome], outcome)}" for outcome in ORDER if count[outcome])
    return parts and f"Of {counted(count.total(), 'verdict')} on what runs took, not repeatable, {parts}."


def _verdict_sentence(plan: Plan, verdicts: Sequence[Verdict]) -> str:
    by_requirement = [group for group in _by_requirement(plan, verdicts) if group]
    count = Counter(outcome_of(group) for group in by_requirement)
    total = len(by_requirement)
    how = f"at {confidences(plan)} confidence {'each' if plan.keys.level == 'each' else 'together'}"
    sign = {"failed": "✗", "undecided": "?", "met": "✓"}[next(outcome for outcome in ORDER if count[outcome])]
    if count["met"] == total:
        one = "The requirement is" if total == 1 else f"All {total} requirements are"
        return f"{sign} {one} met, {how}."
    lead = "Not met" if count["failed"] else "Not decided"
    if total in count.values():
        subject = "the requirement" if total == 1 else f"all {total} requirements"
        return f"{sign} {lead}: {subject} {_verb(total, next(iter(count)))}, {how}."
    parts = [f"{count[outcome]} {_verb(count[outcome], outcome)}" for outcome in ORDER if count[outcome]]
    return f"{sign} {lead}: of {total} requirements {', '.join(parts[:-1])} and {parts[-1]}, {how}."


def confidences(plan: Plan) -> str:
    """The confidence of the requirements, or their range."""
    levels = sorted({100 * requirement.confidence for requirement in plan.keys.require})
    return " to ".join(dict.fromkeys(f"{value:g} %" for value in (levels[0], levels[-1])))


def requirement_sections(plan: Plan, verdicts: Sequence[Verdict]) -> Iterator[Block]:
    """Each requirement with its verdicts, and their intervals against the threshold: first what is not met."""
    note = "Each end of an interval holds by itself, with the confidence of the requirement; dashed is the threshold."
    yield Text(note, "soft", Where.PAGE)
    by_requirement = _by_requirement(plan, verdicts)
    required = plan.keys.require
    ordered = sorted(range(len(required)), key=lambda index: ORDER.index(outcome_of(by_requirement[index])))
    for place in sorted(ordered, key=lambda index: required[index].of_time):  # those on what runs took stand apart
        group, requirement = by_requirement[place], required[place]
        given = {key: value if isinstance(value, list) else [value] for key, value in requirement.where.items()}
        about = [f"{key} {' or '.join(map(value_text, values))}" for key, values in given.items()]
        text = ", ".join([with_name(requirement_text(requirement)), *about])
        count = Counter(verdict.outcome for verdict in group)
        note = SIGNS[outcome_of(group)] + " (not repeatable)" * requirement.of_time
        if len(count) > 1:
            note += f" ({', '.join(f'{count[outcome]} {outcome}' for outcome in ORDER if count[outcome])})"
        elif len(group) > 1:
            note += " in both cases" if len(group) == 2 else f" in all {len(group):,} cases"
        yield Heading(f"{place + 1}. {text}: {note}", 3, bad=count["failed"] > 0)
        yield from _table(plan, requirement, group)


def _table(plan: Plan, requirement: Requirement, verdicts: Sequence[Verdict]) -> Iterator[Block]:
    ordered = sorted(verdicts, key=lambda verdict: ORDER.index(verdict.outcome))
    shown = ordered[:MAX_ROWS]
    of_mean = requirement.share is None
    limit = requirement.threshold if requirement.share is None else requirement.share
    least = not of_mean or requirement.at_least is not None  # the interval must lie above the limit
    values = (value for verdict in shown for value in (verdict.estimate, verdict.low, verdict.high))
    span = span_of([limit, *map(or_nan, values)])
    span = span if of_mean else (max(0.0, span[0]), min(1.0, span[1]))
    keys, groups = varying(plan), groups_of(plan, requirement)
    confidences = [verdict.confidence for verdict in shown] or [requirement.confidence]
    levels = ", ".join(dict.fromkeys(map(percent, confidences)))
    share = "share of seeds" if requirement.known_at_m is None else "share of approaches"
    interval = f"{'mean' if of_mean else share} [interval, each end {levels}]"
    interval = "worst run" if of_mean and requirement.of_time else interval
    side = f"at {'least' if least else 'most'} {three_digits(limit)}"
    axis = f"{three_digits(span[0])} to {three_digits(span[1])}; shaded: {side}"
    header = ("tracker", *key_columns(keys), *groups, "outcome", interval, axis, *OFTEN_EMPTY, "seeds")

    def row(verdict: Verdict) -> Row:
        ends = ChartInterval(or_nan(verdict.estimate), or_nan(verdict.low), or_nan(verdict.high))
        estimate = three_digits_with_interval(verdict.estimate, ends.low, ends.high)
        label = f"{estimate} against {three_digits(limit)}"
        return (
            verdict.tracker,
            *condition_cells(plan, verdict.condition, keys),
            *(str(verdict.values[group]) for group in groups),
            SIGNS[verdict.outcome],
            estimate,
            Cell("", draw=partial(strip, ends, limit, least, span, label)),
            *(f"{count:,}" for count in (verdict.crashed, verdict.nothing, verdict.undefined, verdict.seeds)),
        )

    rows = [row(verdict) for verdict in shown]
    kept, names = without_empty(rows, header, OFTEN_EMPTY)
    bad = {place for place, verdict in enumerate(shown) if verdict.outcome == "failed"}
    table = Table("", names, kept, bad, notes={place: _note(verdict, limit) for place, verdict in enumerate(shown)})
    if len(rows) > MAX_OPEN:
        first = sum(verdict.outcome != "met" for verdict in shown)
        yield Fold(f"All {counted(len(rows), 'verdict')}, failed ones first", [table], 0 < first <= MAX_OPEN)
    elif all(verdict.outcome == "met" for verdict in verdicts):
        yield Fold(f"{counted(len(rows), 'verdict')}, all met", [table])
    else:
        yield table
    if len(ordered) > MAX_ROWS:
        yield Text(f"{len(ordered) - MAX_ROWS:,} more verdicts are in verdicts.json.", "soft")


def _note(verdict: Verdict, limit: float) -> str:
    """Reason why a verdict is what it is, where that is more than its interval says as printed."""
    if verdict.qualified or verdict.low is None or verdict.high is None:
        return verdict.why
    interval = three_digits_with_interval(verdict.estimate, verdict.low, verdict.high)
    return verdict.why if three_digits(limit) in interval else ""


def _by_requirement(plan: Plan, verdicts: Sequence[Verdict]) -> list[list[Verdict]]:
    groups: list[list[Verdict]] = [[] for _ in plan.keys.require]
    for verdict in verdicts:
        groups[verdict.requirement].append(verdict)
    return groups


def _verb(count: int, outcome: Outcome) -> str:
    return "failed" if outcome == "failed" else f"{'is' if count == 1 else 'are'} {outcome}"


def or_nan(value: float | None) -> float:
    """A finite number as it is, NaN for others and for None."""
    return np.nan if value is None or np.isinf(value) else value


_ROWS = ".rows", ".parquet"


def rests_on(folder: CampaignFolder, page: str, command: str | None) -> Provenance:
    """Provenance of a page of the kind `page`; `command` made it, the call from Python if None."""
    keys, facts = folder.keys, folder.facts
    traffic = f"{keys.search.seeds:,} to choose from" if keys.search else f"{keys.seeds.traffic:,}"
    what, when = "file that the campaign names", "when it was planned"
    own = [Input(what, name, digest, when) for name, digest in facts["files"].items()]
    about = "of everything that decides a row; what a worker compares"
    plan = Input("plan", f"sha256 in {PLAN}", facts["sha256"], about)
    return Provenance(
        page=page,
        made_by=command or f"modsim3d.report_campaign of {folder.path} from Python",
        inputs=(*_files(folder), plan, *own),
        seeds=(("campaign", f"{keys.seed}"),),
        options=(("Traffic seeds", traffic), ("Detector seeds", f"{keys.seeds.detector:,} for each traffic seed")),
        made_before=(("Its rows were made with", versions_in_words(facts["versions"])),),
    )


def _files(folder: CampaignFolder) -> list[Input]:
    read = [path for path in files_of_campaign(folder) if path.is_file()]
    rows = [path for path in read if path.suffix in _ROWS]
    named = {FILE: "campaign file", PLAN: "plan with all checksums"}
    inputs = [file_input(what, folder.path / name) for name, what in named.items() if (folder.path / name).is_file()]
    return inputs + ([folder_input("rows of the runs", folder.path, rows)] if rows else [])
