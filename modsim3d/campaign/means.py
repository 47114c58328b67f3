"""Mean scores over traffic seeds with their intervals, by tracker and condition."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isclose, isnan, nan
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.plan import Condition, Plan, groups_of, key_columns, value_cells
from modsim3d.campaign.verdicts.seed_values import columns_of
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.row import CRASHED, REPEATS
from modsim3d.campaign.work.scenes import digest
from modsim3d.core.document import Table, Where
from modsim3d.core.errors import ModsimError
from modsim3d.core.statistics import half_widths
from modsim3d.core.text import counted, listed, three_digits_with_interval
from modsim3d.io.validation import nearest, shown

LEVEL = 0.95
USUAL = ("hota", "deta", "assa", "idf1", "id_switches")
USUAL_IN_WORLD = ("rmse_m", "gospa_m", "followed_share", "world_id_switches", "established_m")
"""Scores of a table unless others are asked for."""
TRACKER, SEED = "tracker", "traffic_seed"


@dataclass(frozen=True)
class Mean:
    """The mean of a score over traffic seeds.

    Attributes:
        value: The mean; None if no seed has a value.
        low: Lower end of the 95 % interval (Student's t over traffic seeds); None with fewer than two seeds, or where
            all have one value, of which nothing follows for others.
        high: Its upper end.
        seeds: Number of traffic seeds with a value.
    """

    value: float | None
    low: float | None
    high: float | None
    seeds: int


@dataclass(frozen=True)
class MeanRow:
    """The mean scores of a tracker with some values of the varied keys.

    Attributes:
        values: `tracker`, and the values of the keys that the means are taken by.
        runs: Number of runs.
        crashed: Number of those that crashed, which are in no mean.
        means: Score → its mean.
    """

    values: dict[str, Any]
    runs: int
    crashed: int
    means: dict[str, Mean]


def usual_keys(plan: Plan) -> tuple[str, ...]:
    """The varied keys that tell conditions from each other: all but those that are drawn."""
    return tuple(key for key in plan.parameters if key not in plan.drawn)


def usual_scores(plan: Plan, table: pa.Table) -> tuple[str, ...]:
    """The columns that requirements are about, as far as there are rows with them, and those of some other scores."""
    required = [column for requirement in plan.keys.require for column in columns_of(plan, requirement)]
    usual = [score for score in (*USUAL, *USUAL_IN_WORLD) if score in table.column_names]
    some = [score for score in usual if table[score].null_count < len(table)] or USUAL
    return tuple(dict.fromkeys(score for score in (*required, *some) if score in table.column_names))


def mean_rows(table: pa.Table, by: Sequence[str], scores: Sequence[str]) -> list[MeanRow]:
    """Means by tracker and keys, in the order of the plan: first of all runs of a traffic seed, then of the seeds. Runs
    that differ in other keys than `by` are taken together. Raises ModsimError if there is no such key or score."""
    _check(table, by, scores)
    keys = [*dict.fromkeys([*by, TRACKER])]
    crashed = pc.equal(table["status"], CRASHED).cast(pa.int64())
    table = table.select([*dict.fromkeys([*keys, SEED, "run", *scores])]).append_column("crashed runs", crashed)
    by_seed = table.group_by([*keys, SEED], use_threads=False).aggregate(
        [("run", "min"), ("run", "count"), ("crashed runs", "sum"), *((score, "mean") for score in scores)]
    )
    spread = pc.VarianceOptions(ddof=1)
    groups = by_seed.group_by(keys, use_threads=False).aggregate(
        [
            *(("run_min", "min"), ("run_count", "sum"), ("crashed runs_sum", "sum")),
            *((f"{score}_mean", "mean") for score in scores),
            *((f"{score}_mean", "stddev", spread) for score in scores),
            *((f"{score}_mean", "count") for score in scores),
        ]
    )
    return [_mean_row(row, keys, scores) for row in groups.sort_by("run_min_min").to_pylist()]


def _mean_row(row: dict[str, Any], keys: Sequence[str], scores: Sequence[str]) -> MeanRow:
    means = {
        score: _mean(row[f"{score}_mean_mean"], row[f"{score}_mean_stddev"], row[f"{score}_mean_count"])
        for score in scores
    }
    return MeanRow({key: row[key] for key in keys}, row["run_count_sum"], row["crashed runs_sum_sum"], means)


def _mean(value: float | None, deviation: float | None, seeds: int) -> Mean:
    half = nan if value is None or deviation is None else float(half_widths(value, deviation, seeds, (1 - LEVEL) / 2))
    if value is None or isnan(half):
        return Mean(value, None, None, seeds)
    return Mean(value, value - half, value + half, seeds)


def _check(table: pa.Table, by: Sequence[str], scores: Sequence[str]) -> None:
    """Check that the rows have these keys and scores; ModsimError if they do not."""
    names = table.column_names
    first = names.index(SEED)
    keys = ["scene", TRACKER, *names[names.index("tracker") + 1 : names.index("status")]]
    for key in by:
        if key not in keys:
            raise ModsimError(f"--by {key}: is not varied in this campaign ({nearest(key, keys)})")
    kinds = {name: table[name].type for name in names[first:] if name not in (*keys, SEED, "detector_seed")}
    numbers = [name for name, kind in kinds.items() if pa.types.is_floating(kind) or pa.types.is_integer(kind)]
    for score in scores:
        if score not in numbers:
            raise ModsimError(f"--score {score}: there is no such score in this campaign ({nearest(score, numbers)})")


CRASHED_RUNS = "crashed runs"


def mean_table(
    rows: Sequence[MeanRow],
    title: str = "mean scores [95 % interval over traffic seeds]",
    where: Where = Where.TEXT,
    names: Callable[[str], str] = str,
) -> Table:
    """Table with a row for each tracker and values of the keys; runs that crashed stand out. Only the places `where`
    show it; `names` tells what columns of scores are called."""
    if not rows:
        return Table(title, (), ())
    keys, scores = [key for key in rows[0].values if key != TRACKER], list(rows[0].means)
    most_seeds = max((mean.seeds for row in rows for mean in row.means.values()), default=0)
    crashed = any(row.crashed for row in rows)
    header = [*key_columns(keys), TRACKER, "runs", *([CRASHED_RUNS] if crashed else []), *map(names, scores)]
    cells = [
        [
            *value_cells(row.values, keys),
            row.values[TRACKER],
            f"{row.runs:,}",
            *([f"{row.crashed:,}"] if crashed else []),
            *(_mean_text(row.means[score], most_seeds) for score in scores),
        ]
        for row in rows
    ]
    return Table(title, header, cells, {place for place, row in enumerate(rows) if row.crashed}, where=where)


REQUIRED = "Intervals of means that are required are those of the requirements."


def required_means(plan: Plan, verdicts: Sequence[Verdict]) -> list[tuple[str, dict[str, Any], Verdict]]:
    """The first verdict on each mean of a tracker, with the column of its score and the values that its rows have."""
    means: dict[tuple[str, int, str], tuple[str, dict[str, Any], Verdict]] = {}
    for verdict in verdicts:
        requirement = plan.keys.require[verdict.requirement]
        if requirement.share is None and requirement.of is None:
            values = {**verdict.values, TRACKER: verdict.tracker}
            column = "".join(f"{key}.{values.pop(key)}." for key in groups_of(plan, requirement)) + requirement.score
            means.setdefault((column, verdict.condition, verdict.tracker), (column, values, verdict))
    return list(means.values())


def with_required(plan: Plan, rows: Sequence[MeanRow], verdicts: Sequence[Verdict]) -> list[MeanRow]:
    """Means with the intervals of their requirements in place of Student's: a mean has one interval."""
    required = required_means(plan, verdicts)

    def interval(row: MeanRow, score: str) -> Mean:
        mean = row.means[score]
        for column, values, verdict in required:
            if column == score and values == row.values:
                low, high = interval_of(verdict, mean.value)
                return replace(mean, low=low, high=high)
        return mean

    return [replace(row, means={score: interval(row, score) for score in row.means}) for row in rows]


def interval_of(verdict: Verdict, mean: float | None) -> tuple[float | None, float | None]:
    """The interval of a verdict, if it is on this mean and not on one that counts crashed runs too."""
    if mean is None or verdict.estimate is None or not isclose(mean, verdict.estimate):
        return None, None
    return verdict.low, verdict.high


def _mean_text(mean: Mean, most: int) -> str:
    """A mean with its interval, and its number of seeds if that is not the one of most."""
    few = f" of {counted(mean.seeds, 'seed')}" if mean.value is not None and mean.seeds < most else ""
    return three_digits_with_interval(mean.value, mean.low, mean.high) + few


def repeat_sentences(plan: Plan, table: pa.Table) -> list[str]:
    """A sentence for each program: whether its first run gave the same tracks when it was made again at once."""
    programs = [place for place, tracker in enumerate(plan.keys.trackers) if tracker.command is not None]
    names = [name for name in ("run", "status", TRACKER, REPEATS) if name in table.column_names]
    texts = {
        True: "made twice: {} gave the same tracks",
        False: "made twice: {} gave OTHER TRACKS, so its rows depend on chance",
        None: "crashed: whether {} gives the same tracks again is not known",
    }
    rows = table.select(names).filter(pc.is_in(table["run"], pa.array(programs, pa.int64()))).to_pylist()
    outcomes = [(row, row.get(REPEATS)) for row in rows if row.get(REPEATS) is not None or row["status"] == CRASHED]
    return [f"Run {row['run']} {texts[repeats].format(row[TRACKER])}." for row, repeats in outcomes]


def same_detections(plan: Plan, table: pa.Table) -> list[str]:
    """A sentence for each group of conditions whose scenes or detectors differ and whose detections do not."""
    names, seen = ("condition", "traffic_seed", "detector_seed", "detections_sha256"), dict[int, set[tuple[str, ...]]]()
    if not {*names} <= {*table.column_names}:  # it was made by an older version, or has no rows
        return []
    for place, *record in zip(*(table[name].to_pylist() for name in names), strict=True):
        if None not in record:
            seen.setdefault(place, set()).add(tuple(map(str, record)))
    groups: dict[str, dict[str, Condition]] = {}
    for place in sorted(seen):
        condition = plan.conditions[place]
        asked = digest(condition.scene, condition.of_truth(), condition.of_detector())
        groups.setdefault(digest(sorted(seen[place])), {}).setdefault(asked, condition)
    return [
        f"the detections are the same in all runs with {_in_words([*group.values()])}: what differs there changes "
        "nothing that a tracker sees, and a verdict on one condition says nothing of the other"
        for group in groups.values()
        if len(group) > 1
    ]


def _in_words(conditions: list[Condition]) -> str:
    """The values of each condition that are not those of all of them."""
    values = [{"scene": condition.scene, **condition.of_truth(), **condition.of_detector()} for condition in conditions]
    keys = dict.fromkeys(key for facts in values for key in facts)
    differing = [key for key in keys if len({shown(facts.get(key)) for facts in values}) > 1]
    return listed([" and ".join(f"{key} {shown(facts.get(key))}" for key in differing) for facts in values])
