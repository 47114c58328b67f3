"""What is compared: means of trackers in conditions, and the paired differences between trackers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array, Indices
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.plan.selection import cases_of
from modsim3d.campaign.report.cells import over_seeds, seed_cells
from modsim3d.campaign.report.tables import without_empty
from modsim3d.campaign.report.words import (
    MOST_KEYS,
    Score,
    condition_cells,
    number,
    required_scores,
    table_scores,
    varying,
    with_interval,
)
from modsim3d.campaign.results.means import LEVEL
from modsim3d.campaign.verdicts.paired import PairedDifference, paired
from modsim3d.campaign.verdicts.seed_values import column_of
from modsim3d.campaign.work.row import DONE
from modsim3d.view.pages import page
from modsim3d.view.pages.intervals import Interval, span_of, strip

MOST_ROWS = 200
"""Of a table."""
CRASHED_RUNS = "crashed runs"


def mean_sections(plan: Plan, table: pa.Table) -> list[str]:
    """The table of means: a row for each condition and tracker."""
    scores = table_scores(plan)
    found = [over_seeds(seed_cells(plan, table, score.column)) for score in scores]
    crashed = _crashed(plan, table)
    places = [(c, t) for c in range(len(plan.conditions)) for t in range(len(plan.keys.trackers))]
    remark = ""
    if len(places) > MOST_ROWS:
        worst = _badness(scores[0], found[0].mean)
        places = sorted(sorted(places, key=lambda each: worst[each])[:MOST_ROWS])
        remark = (
            f" The {MOST_ROWS} rows of {worst.size:,} with the worst {scores[0].name} are shown; "
            "modsim3d campaign-table has all."
        )
    keys, judged = varying(plan), _judged(plan)
    remark += " Intervals of means that are required are those of the requirements, above." * bool(judged)
    rows = [
        (
            *condition_cells(plan, c, keys),
            plan.keys.trackers[t].label,
            *(
                number(each.mean[c, t])
                if (score.column, c, t) in judged
                else with_interval(each.mean[c, t], each.low[c, t], each.high[c, t])
                for score, each in zip(scores, found, strict=True)
            ),
            f"{found[0].seeds[c, t]:,}",
            f"{crashed[c, t]:,}",
        )
        for c, t in places
    ]
    columns = keys if len(keys) <= MOST_KEYS else ["condition"]
    header = (*columns, "tracker", *(score.name for score in scores), "seeds", CRASHED_RUNS)
    bad = {place for place, each in enumerate(places) if crashed[each]}
    return [
        page.paragraph(
            f"Mean over traffic seeds [{100 * LEVEL:g} % interval by Student's t]. The value of a seed is the mean "
            "over its detector seeds. All trackers and conditions have the same seeds. Each interval holds by itself: "
            f"of twenty, one is expected to miss.{_stopped(plan)}{remark}",
            "soft",
        ),
        page.table(*without_empty(rows, header, (CRASHED_RUNS,)), bad=bad),
    ]


def _judged(plan: Plan) -> set[tuple[str, int, int]]:
    """Column, condition and tracker of the means that requirements are about."""
    return {
        (column_of(requirement.score, case), case.condition, case.tracker)
        for requirement in plan.keys.require
        if requirement.share is None and requirement.of is None
        for case in cases_of(plan, requirement)
    }


def _stopped(plan: Plan) -> str:
    """What a sequential campaign does to intervals for a number of seeds that was fixed beforehand."""
    if plan.keys.stop == "once":
        return ""
    return (
        " This campaign ended when its requirements were decided, so these intervals describe and prove nothing: those "
        "of the requirements hold however often they are looked at."
    )


def _badness(score: Score, mean: Array) -> Array:
    """The lower, the worse; where nothing is known comes first."""
    signed = mean if score.lowest_is_worst else -mean
    return np.where(np.isfinite(signed), signed, -np.inf)


def _crashed(plan: Plan, table: pa.Table) -> Indices:
    """Number of crashed runs, shape (conditions, trackers)."""
    runs = table.filter(pc.not_equal(table["status"], DONE))["run"].to_numpy()
    shape = (len(plan.conditions), plan.keys.seeds.detector, len(plan.keys.trackers))
    counts: Indices = np.bincount(runs % plan.runs_by_seed, minlength=plan.runs_by_seed).reshape(shape).sum(axis=1)
    return counts


def paired_sections(plan: Plan, table: pa.Table) -> list[str]:
    """The differences between trackers over the same seeds, and what the pairing gained."""
    if len(plan.keys.trackers) < 2 or not len(table):
        return []
    scores = dict.fromkeys(each.key for each in required_scores(plan) if each.key in table.column_names)
    found = [each for score in scores for each in paired(plan, table, score)]
    if not found:
        return []
    judged = {
        (requirement.score, case.condition, frozenset((requirement.of, requirement.minus)))
        for requirement in plan.keys.require
        if requirement.share is None
        for case in cases_of(plan, requirement)
        if case.part is None
    }
    said = [(each.score, each.condition, frozenset((each.first, each.second))) in judged for each in found]
    found = [replace(each, low=None, high=None) if here else each for each, here in zip(found, said, strict=True)]
    remark = " Intervals of differences that are required are those of the requirements, above." * any(said)
    keys, span = varying(plan), {}
    for score in {each.score for each in found}:
        here = [each for each in found if each.score == score]
        span[score] = span_of([0.0, *(_or_nan(v) for each in here for v in (each.mean, each.low, each.high))])
    rows = [
        (
            Score(each.score).name,
            *condition_cells(plan, each.condition, keys),
            f"{each.first} − {each.second}",
            with_interval(each.mean, each.low, each.high),
            _difference(each, span[each.score]),
            f"{each.seeds:,}",
            number(each.variance_ratio),
        )
        for each in found[:MOST_ROWS]
    ]
    columns = keys if len(keys) <= MOST_KEYS else ["condition"]
    header = ("score", *columns, "difference", "mean [interval]", "against 0", "seeds", "variance ratio")
    return [
        page.heading("Differences between trackers"),
        page.paragraph(
            "Mean of the difference with the same traffic seeds, with its interval at 95 %: if 0 lies inside, this "
            "campaign does not tell which tracker is better. The variance ratio says how many times as many seeds "
            "would have been needed for this interval with other seeds for each tracker; near 1, pairing gained "
            f"nothing.{remark}",
            "soft",
        ),
        page.table(rows, header, markup=(len(columns) + 3,)),
    ]


def _difference(each: PairedDifference, span: tuple[float, float]) -> str:
    found = Interval(_or_nan(each.mean), _or_nan(each.low), _or_nan(each.high))
    return strip(found, 0.0, None, span, f"{with_interval(found.mean, found.low, found.high)} against 0")


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
