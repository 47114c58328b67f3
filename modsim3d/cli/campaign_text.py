"""Texts of the commands for campaigns: a plan, verdicts, means and crashed runs, in words and tables."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.cli.shared import print_line
from modsim3d.cli.terminal import print_prose, print_table
from modsim3d.core.text import counted, listed
from modsim3d.io.validation import shown

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.console import Console

    from modsim3d.campaign.keys import CampaignKeys, Factor, Range, Requirement
    from modsim3d.campaign.means import Mean, MeanRow
    from modsim3d.campaign.plan import Plan
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


def print_verdicts(console: Console, title: str, verdicts: Sequence[Verdict], reasons: bool) -> None:
    """Print verdicts, the failed ones first.

    Args:
        console: Where to.
        title: Above them.
        verdicts: The verdicts.
        reasons: Whether to say why some are undecided, and on which runs and seeds the others do not rest.
    """
    ordered = sorted(verdicts, key=lambda verdict: FIRST.index(verdict.outcome))
    shown_ones = ordered[:MAX_ROWS]
    print_table(
        console,
        title,
        [verdict_row(verdict) for verdict in shown_ones],
        header=("requirement", "tracker", "condition", "outcome", "estimate", "interval, level of each end", "seeds"),
        right=(4, 6),
        row_styles=[STYLES[verdict.outcome] for verdict in shown_ones],
    )
    _print_rest(console, len(ordered))
    if reasons:
        undecided = [verdict for verdict in shown_ones if verdict.outcome == "undecided"][:MAX_ERRORS]
        qualified = [verdict for verdict in shown_ones if verdict.qualified and verdict not in undecided]
        for verdict in (*undecided, *qualified):
            print_prose(console, f"{about_text(verdict)}: {verdict.why}", "dim")


def about_text(verdict: Verdict) -> str:
    """Subject of a verdict, in a few words."""
    about = ", ".join(filter(None, [verdict.tracker, values_text(verdict.values)]))
    return f"{verdict.text} ({about})"


def verdict_row(verdict: Verdict) -> tuple[str, ...]:
    """A verdict as cells; the ends of its interval are rounded as in its sentence."""
    from modsim3d.campaign.verdicts.wording import percent, rounded_down, rounded_up

    interval = UNKNOWN
    if verdict.low is not None or verdict.high is not None:
        low = UNKNOWN if verdict.low is None else rounded_down(verdict.low)
        high = UNKNOWN if verdict.high is None else rounded_up(verdict.high)
        interval = f"[{low}, {high}] {percent(verdict.confidence)}".replace("-", "−")
    return (
        verdict.text,
        verdict.tracker,
        values_text(verdict.values) or UNKNOWN,
        verdict.outcome,
        UNKNOWN if verdict.estimate is None else number_text(verdict.estimate),
        interval,
        f"{verdict.seeds:,}",
    )


def values_text(values: Mapping[str, Any]) -> str:
    """Values of keys on one line."""
    return ", ".join(f"{key} {_plain(value)}" for key, value in values.items())


def number_text(value: float) -> str:
    """A score with four digits or so."""
    if abs(value) == float("inf"):
        return f"{value:g}".replace("inf", "∞")
    return f"{value:,.0f}" if abs(value) >= 10_000 else f"{value:.4g}" if abs(value) >= 1 else f"{value:.3f}"


def interval_text(low: float | None, high: float | None) -> str:
    """An interval; an end that is not bounded is a dash."""
    ends = [UNKNOWN if end is None else number_text(end) for end in (low, high)]
    return f"[{ends[0]}, {ends[1]}]".replace("-", "−")


def mean_text(mean: Mean, most: int) -> str:
    """A mean with its interval, and its number of seeds if that is not the one of most."""
    if mean.value is None:
        return UNKNOWN
    value = number_text(mean.value).replace("-", "−") + (f" of {counted(mean.seeds, 'seed')}" * (mean.seeds < most))
    return value if mean.low is None else f"{value} {interval_text(mean.low, mean.high)}"


def without_judged(plan: Plan, rows: Sequence[MeanRow], verdicts: Sequence[Verdict]) -> list[MeanRow]:
    """Means without the intervals of those that have a verdict, which are printed with it."""
    from modsim3d.campaign.plan import groups_of

    said = []
    for each in verdicts:
        requirement, values = plan.keys.require[each.requirement], {**each.values, "tracker": each.tracker}
        part = [f"{key}.{values.pop(key)}." for key in groups_of(plan, requirement)]
        if requirement.share is None:
            said.append(("".join([*part, requirement.score]), values))
    return [
        replace(
            row,
            means={
                score: replace(mean, low=None, high=None) if (score, row.values) in said else mean
                for score, mean in row.means.items()
            },
        )
        for row in rows
    ]


def print_means(console: Console, title: str, rows: Sequence[MeanRow], most: int | None = MAX_ROWS) -> None:
    """Print mean scores with their intervals, by tracker and keys."""
    if not rows:
        return
    keys, scores = list(rows[0].values), list(rows[0].means)
    most_seeds = max((mean.seeds for row in rows for mean in row.means.values()), default=0)
    crashed = any(row.crashed for row in rows)
    header = (*keys, "runs", *(["crashed"] if crashed else []), *scores)
    cells = [
        (
            *(UNKNOWN if row.values[key] is None else _cell(row.values[key]) for key in keys),
            f"{row.runs:,}",
            *([f"{row.crashed:,}"] if crashed else []),
            *(mean_text(row.means[score], most_seeds) for score in scores),
        )
        for row in rows[:most]
    ]
    print_table(
        console,
        title,
        cells,
        header=header,
        right=range(len(keys), len(header)),
        breaks=(lambda cell: cell.replace(" [", "\n["),),
    )
    if most is not None:
        _print_rest(console, len(rows))


def _cell(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else _plain(value)


def _print_rest(console: Console, rows: int) -> None:
    if rows > MAX_ROWS:
        print_line(console, f"… and {rows - MAX_ROWS:,} more", "dim")


def crashed_lines(table: pa.Table) -> list[tuple[str, int, list[int]]]:
    """The errors of runs that crashed: the text, how many, and the first few of their numbers."""
    import pyarrow.compute as pc

    from modsim3d.campaign.work.row import CRASHED

    crashed = table.filter(pc.equal(table["status"], CRASHED))
    found: dict[str, list[int]] = {}
    for number, error in zip(crashed["run"].to_pylist(), crashed["error"].to_pylist(), strict=True):
        found.setdefault(error or "", []).append(number)
    return [
        (error, len(numbers), numbers[:3]) for error, numbers in sorted(found.items(), key=lambda each: -len(each[1]))
    ]


def print_crashed(console: Console, table: pa.Table, folder: Path) -> None:
    """Print the errors of runs that crashed, the most frequent ones first, and how to see one again."""
    from modsim3d.campaign.ranking import RUNS_FOLDER

    found = crashed_lines(table)
    if not found:
        return
    console.print()
    print_prose(console, "crashed runs", "bold red")
    for error, count, numbers in found[:MAX_ERRORS]:
        some = ", ".join(map(str, numbers)) + (", …" if count > len(numbers) else "")
        print_prose(console, f"{counted(count, 'run')} ({some}): {error}", indent=2)
    if len(found) > MAX_ERRORS:
        print_prose(console, f"… and {len(found) - MAX_ERRORS:,} other errors", "dim", indent=2)
    number, quoted = found[0][2][0], shlex.quote(str(folder))
    out = shlex.quote(str(folder / RUNS_FOLDER / str(number)))
    print_line(console, f"  the first again: modsim3d campaign reproduce {quoted} {number} --out {out}", "dim")


def duration_text(seconds: float | None) -> str:
    """A time that something will take."""
    if seconds is None:
        return "time left unknown"
    if seconds < 90:
        return f"{max(1, round(seconds))} s left"
    minutes = round(seconds / 60)
    return f"{minutes} min left" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min left"
