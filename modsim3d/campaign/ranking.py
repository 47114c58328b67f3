"""Worst runs of a campaign, and how each is looked at."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import pyarrow as pa

from modsim3d.campaign.folder import CampaignFolder
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.verdicts.seed_values import columns_of
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.row import CRASHED, error_text
from modsim3d.core.arrays import Indices, Mask

USUAL_SCORE = "hota"
_OUTCOMES = ("failed", "undecided", "met")


@dataclass(frozen=True)
class WorstRun:
    """A run that went wrong."""

    number: int  # in the plan
    tracker: str  # name in tables
    condition: int
    traffic_seed: int
    detector_seed: int
    score: str  # column by which it is one of the worst; of a run that crashed, `status`
    value: float | None  # in that column; None of a run that crashed
    moment_s: float | None  # at which it went wrong, as its timestamps have it; None if nothing did, or it crashed
    again: str  # command that makes the run again
    film: str  # command that films the moment; empty if there is none
    error: str | None = None  # None if it did not crash
    requirement: int | None = None  # index of the one that names it; None if it crashed, and without requirements


@dataclass(frozen=True, eq=False)
class _Ranking:
    """Runs in the order of a score: the rows of the table, the worst first, the score's column, and for what."""

    rows: Indices
    score: str
    requirement: int | None = None


def worst_runs(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict], count: int = 5) -> list[WorstRun]:
    """The runs that went worst, each once, `count` at most. First come runs that crashed. Then each requirement that
    failed names its worst run, and its second worst, and so on; then each that is undecided; then each that is met.
    Without requirements it is the lowest HOTA that counts."""
    worst = islice(_each_once(folder.plan, table, verdicts), count)
    return [_worst_run(folder, table.slice(row, 1).to_pylist()[0], ranking) for row, ranking in worst]


def score_of_run(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict], number: int) -> str:
    """Column of the score by which a run is one of the worst, in a search that which is searched; empty if none is."""
    if (search := folder.keys.search) is not None:
        return search.minimise or search.maximise or ""
    numbers = table["run"].to_pylist()
    ranked = _each_once(folder.plan, table, verdicts)
    return next((ranking.score for row, ranking in ranked if numbers[row] == number), "")


def _each_once(plan: Plan, table: pa.Table, verdicts: Sequence[Verdict]) -> Iterator[tuple[int, _Ranking]]:
    """Rows of a table, the worst first, with the ranking that names each first."""
    crashed = np.flatnonzero(np.asarray(table["status"].to_numpy(zero_copy_only=False)) == CRASHED)
    named = set[int]()
    for rankings in ([_Ranking(crashed, "status")], *_rankings(plan, table, verdicts)):
        for row, ranking in _by_turns(rankings):
            if row not in named:
                named.add(row)
                yield row, ranking


def _rankings(plan: Plan, table: pa.Table, verdicts: Sequence[Verdict]) -> Iterator[list[_Ranking]]:
    """The rankings that take turns: those of requirements that failed, are undecided, are met; or the usual one."""
    if not verdicts:
        every = np.ones(len(table), dtype=bool)
        yield [_ranking(table, [USUAL_SCORE], every, lowest=True), _ranking(table, ["gospa_m"], every, lowest=False)]
    for outcome in _OUTCOMES:
        by_requirement: dict[int, list[Verdict]] = {}
        for verdict in verdicts:
            if verdict.outcome == outcome:
                by_requirement.setdefault(verdict.requirement, []).append(verdict)
        yield [_of_requirement(plan, table, group) for group in by_requirement.values()]


def _of_requirement(plan: Plan, table: pa.Table, verdicts: Sequence[Verdict]) -> _Ranking:
    requirement, labels = plan.keys.require[verdicts[0].requirement], [tracker.label for tracker in plan.keys.trackers]
    trackers = np.asarray(table["tracker"].to_pylist(), dtype=object)
    conditions = table["condition"].to_numpy()
    chosen = np.zeros(len(table), dtype=bool)
    for verdict in verdicts:
        chosen |= (trackers == (requirement.of or verdict.tracker)) & (conditions == verdict.condition)
    off = 0
    if requirement.of is not None and requirement.minus is not None:
        off = labels.index(requirement.minus) - labels.index(requirement.of)
    ranking = _ranking(table, columns_of(plan, requirement), chosen, lowest=requirement.at_least is not None, off=off)
    return replace(ranking, requirement=verdicts[0].requirement)


def _ranking(table: pa.Table, columns: Sequence[str], chosen: Mask, *, lowest: bool, off: int = 0) -> _Ranking:
    """Chosen rows, the worst first, by the worst of some columns; those without a value are left out. With `off`, the
    values are differences to those of the run whose number is so much greater."""
    names = [name for name in columns if name in table.column_names]
    if not names:
        return _Ranking(np.empty(0, dtype=np.int64), USUAL_SCORE)
    values = np.column_stack([table[name].cast(pa.float64()).to_numpy() for name in names])
    if off:
        others = table["run"].to_numpy() + off
        places = np.minimum(np.searchsorted(table["run"].to_numpy(), others), len(table) - 1)
        there_too = table["run"].to_numpy()[places] == others
        values = np.where(there_too[:, None], values - values[places], np.nan)
    badness = np.where(np.isnan(values), -np.inf, -values if lowest else values).max(axis=1)
    rows = np.flatnonzero(chosen & (badness > -np.inf))
    return _Ranking(rows[np.argsort(-badness[rows], kind="stable")], names[0])


def _by_turns(rankings: Sequence[_Ranking]) -> Iterator[tuple[int, _Ranking]]:
    for place in range(max((len(ranking.rows) for ranking in rankings), default=0)):
        for ranking in rankings:
            if place < len(ranking.rows):
                yield int(ranking.rows[place]), ranking


def _worst_run(folder: CampaignFolder, row: dict[str, object], ranking: _Ranking) -> WorstRun:
    number, moment_s, crashed = row["run"], row["worst_s"], row["status"] == CRASHED
    value = None if crashed else row[ranking.score]
    assert isinstance(number, int)
    again = folder.reproducing(number)
    return WorstRun(
        number=number,
        tracker=str(row["tracker"]),
        condition=int(str(row["condition"])),
        traffic_seed=int(str(row["traffic_seed"])),
        detector_seed=int(str(row["detector_seed"])),
        score=ranking.score,
        value=float(value) if isinstance(value, int | float) else None,
        moment_s=moment_s if isinstance(moment_s, float) else None,
        again=again,
        film="" if moment_s is None else f"{again} --film",
        error=error_text(row) if crashed else None,
        requirement=ranking.requirement,
    )
