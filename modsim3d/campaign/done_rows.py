"""The rows that are done so far, from the files of tasks."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.campaign.folder import FORMAT, RESULTS, TOOK, TOOK_VERDICTS, VERDICTS, CampaignFolder, results_folder
from modsim3d.campaign.keys import MAX_SEEDS, TIMES, Requirement, Seeds
from modsim3d.campaign.plan import SCENE, Case, Plan, PlannedRun, cases_of, labels_of, value_column, value_of
from modsim3d.campaign.verdicts import bounds, wording
from modsim3d.campaign.verdicts.seed_values import SeedRows
from modsim3d.campaign.verdicts.verdict import Verdict, repeatable
from modsim3d.campaign.work.row import DONE, FACTS, REPEATS, SAID, SCORES, limits_of, table_of
from modsim3d.campaign.work.task import ROWS_PATTERN, name_of_rows, read_rows
from modsim3d.core.arrays import Indices
from modsim3d.core.errors import ModsimError
from modsim3d.core.text import counted
from modsim3d.io.atomic_write import json_text, make_folder, sync_file, sync_folder, write_files
from modsim3d.io.validation import nearest

_OF_ALL_PLANS = ("scene", "condition", "traffic_seed", "detector_seed", "tracker")
_TOGETHER = 200  # small tables that are kept before they become one; each costs some 50 kB beside its rows


class DoneRows:
    """The rows of a campaign that is not finished, each file of a task read once."""

    def __init__(self, folder: CampaignFolder) -> None:
        """Take the folder, and read nothing yet."""
        self._folder = folder
        self._parts: list[pa.Table] = []
        self._small: list[pa.Table] = []
        self._read: set[str] = set()

    def read(self, first_runs: Container[int] | None = None) -> DoneRows:
        """Read all files not read yet, or only those whose first run is one of these; damaged ones are left out."""
        for path in sorted(self._folder.done.glob(ROWS_PATTERN)):
            if first_runs is None or int(path.name.partition("_")[0]) in first_runs:
                self.add(path)
        return self

    def add(self, path: Path) -> bool:
        """Read the file of a task; whether it is there, not damaged, and of this plan."""
        if path.name in self._read:
            return True
        rows = read_rows(path)
        if rows is None or path.name != name_of_rows(self._folder.facts["sha256"], rows["run"].to_pylist()):
            return False
        self._read.add(path.name)
        self._small.append(rows.replace_schema_metadata(None))
        if len(self._small) >= _TOGETHER:
            self._join()
        return True

    def numbers(self) -> Indices:
        """The runs whose rows are there, ascending, shape (n,)."""
        self._join()
        columns = [part["run"].to_numpy() for part in self._parts]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *columns]))

    def crashed(self) -> int:
        """Number of rows of runs that crashed."""
        self._join()
        return sum(pc.sum(pc.not_equal(part["status"], DONE)).as_py() for part in self._parts)

    def table(self) -> pa.Table:
        """Rows in the order of the plan, with its columns; of a run that is there twice, one that did not crash."""
        self._join()
        table = pa.concat_tables(self._parts or [with_plan(table_of([]), self._folder.plan)], promote_options="default")
        ahead = list(dict.fromkeys(["run", *plan_columns(self._folder.plan), *FACTS, *SCORES]))
        table = table.select([*ahead, *sorted(set(table.column_names) - set(ahead))])
        crashed = pc.not_equal(table["status"], DONE)
        keys_of_order = [("run", "ascending"), ("crashed", "ascending")]
        table = table.take(pc.sort_indices(pa.table({"run": table["run"], "crashed": crashed}), keys_of_order))
        return table.filter(np.diff(table["run"].to_numpy(), prepend=-1) > 0)

    def _join(self) -> None:
        if self._small:
            joined = pa.concat_tables(self._small, promote_options="default").combine_chunks()
            self._parts.append(with_plan(joined, self._folder.plan))
            self._small = []


def plan_columns(plan: Plan) -> list[str]:
    """The columns that the plan gives to a row."""
    return [*_OF_ALL_PLANS, *(name for name in plan.parameters if name != "scene")]


def with_plan(table: pa.Table, plan: Plan) -> pa.Table:
    """The table with what the plan says of each run after its number."""
    runs = plan.runs(table["run"].to_pylist())
    values = {name: [run.condition.values.get(name) for run in runs] for name in plan.parameters if name != "scene"}
    more = {name: value_column(column, _possible(plan, name)) for name, column in values.items()}
    return with_columns(table, runs, more)


def with_columns(table: pa.Table, runs: Sequence[PlannedRun], more: Mapping[str, pa.Array]) -> pa.Table:
    """A table of runs, with what is known of each of them, and more columns, after its number."""
    columns = {
        "scene": pa.array([Path(run.condition.scene).stem for run in runs], pa.string()),
        "condition": pa.array([run.condition_index for run in runs], pa.int64()),
        "traffic_seed": pa.array([run.traffic_seed for run in runs], pa.int64()),
        "detector_seed": pa.array([run.detector_seed for run in runs], pa.int64()),
        "tracker": pa.array([run.tracker.label for run in runs], pa.string()),
        **more,
    }
    scores = {name: table[name] for name in table.column_names if name != "run"}
    return pa.table({"run": table["run"], **columns, **scores})


def _possible(plan: Plan, name: str) -> Iterator[Any]:
    """The values that a key may have; one for a range of numbers."""
    for condition in plan.conditions:
        if condition.values.get(name) is not None:
            yield condition.values[name]
    for factor in plan.keys.vary:
        if name in factor.ranges:
            choices = factor.ranges[name].choices
            yield from [0.0] if choices is None else [value for value in choices if value is not None]


PART_ROWS = 50_000  # rows of a file of the data set: they follow the plan, whoever made them


def done_rows(folder: CampaignFolder) -> pa.Table:
    """The rows that are done, one for each run in the order of the plan, with the columns of the plan."""
    return DoneRows(folder).read().table()


def write_results(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> None:
    """Write the data set `results/scene=NAME/part-N.parquet` of the rows that count, in the order of the plan. The
    verdicts, which are written afterwards, are in its list of files too, see `results_folder`. Raises OutputError if it
    cannot be written."""
    took = [name for name in (*TIMES, REPEATS, SAID) if name in table.column_names]
    if took:
        make_folder(folder.path)
        write_table(table.select(["run", "tracker", *took]), folder.path / TOOK)
    with results_folder(folder.path, RESULTS, {VERDICTS: _content_of(folder, verdicts)}) as partial:
        for name in dict.fromkeys(table["scene"].to_pylist()):
            rows = table.filter(pc.equal(table["scene"], name)).drop_columns(["scene", *took])
            write_rows(partial / f"scene={name}", rows)


def write_rows(folder: Path, rows: pa.Table) -> None:
    """Write rows into files of a folder, which is made if it is not there; OSError if they cannot be written."""
    make_folder(folder)
    for number, first in enumerate(range(0, len(rows), PART_ROWS)):
        write_table(rows.slice(first, PART_ROWS), folder / f"part-{number:05d}.parquet")
    sync_folder(folder)


def write_table(rows: pa.Table, path: Path) -> None:
    """Write rows into a file; OSError if it cannot be written."""
    pq.write_table(rows, path, compression="zstd", row_group_size=PART_ROWS, write_page_checksum=True)
    sync_file(path)


def write_verdicts(folder: CampaignFolder, verdicts: Sequence[Verdict]) -> None:
    """Write `verdicts.json`, and those that do not repeat into a file of their own; OutputError where that fails."""
    apart = [asdict(verdict) for verdict in verdicts if verdict not in repeatable(folder.plan, verdicts)]
    content = json_text({"format": FORMAT, "repeatable": False, "verdicts": apart})
    files = {folder.path / VERDICTS: _content_of(folder, verdicts)}
    write_files(files | ({folder.path / TOOK_VERDICTS: content} if apart else {}))


def _content_of(folder: CampaignFolder, verdicts: Sequence[Verdict]) -> bytes:
    fixed = [not condition["traffic_has_seed"] for condition in folder.facts["conditions"]]
    kept = repeatable(folder.plan, verdicts)
    records = [{**asdict(verdict), "this_traffic_only": fixed[verdict.condition]} for verdict in kept]
    return json_text({"format": FORMAT, "sha256": folder.facts["sha256"], "verdicts": records})


def results_table(folder: CampaignFolder) -> pa.Table:
    """The rows of a campaign in the order of its plan: its results, or what is done so far."""
    if not folder.finished:
        return done_rows(folder)
    parts = []
    for path in sorted(folder.results.glob("scene=*/part-*.parquet")):
        part = pq.read_table(path, partitioning=None)
        scene = pa.array([path.parent.name.partition("=")[2]] * len(part), pa.string())
        parts.append(part.add_column(1, "scene", scene))
    table = pa.concat_tables(parts, promote_options="default").sort_by("run")
    if folder.keys.timed and (folder.path / TOOK).is_file():
        took = pq.read_table(folder.path / TOOK).drop_columns(["tracker"])
        table = table.join(took, "run", use_threads=False).sort_by("run").combine_chunks()
    return table


POWER = 0.8  # how often a mean as expected is to be met
_DRAWN, _DRAWN_SEQUENTIAL, _MAX_SEEDS = 20_000, 100, 5_000
_NUMBER = r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"


@dataclass(frozen=True)
class Expectation:
    """Expected mean and standard deviation of a score over traffic seeds, and the lost runs that are left out."""

    mean: float
    spread: float
    lost: int = 0


@dataclass(frozen=True)
class NeededSeeds:
    """Number of traffic seeds that a requirement needs."""

    requirement: int  # place in the file, from 0
    text: str  # the requirement in words
    tracker: str | None  # name in tables, or those of two; None: of all
    condition: int | None  # number; None: of all
    seeds: int | None = None  # None if none are enough, or if that is unknown
    why: str = ""  # what that rests on
    expected: Expectation | None = None  # None if unknown, or if it is on a share


def parsed_expectation(text: str, plan: Plan) -> tuple[str, Expectation]:
    """Name and expectation of `SCORE=MEAN:SPREAD` for a required mean; of a difference `SCORE of NEW minus OLD`. Raises
    ModsimError for any other text."""
    if not (match := re.fullmatch(rf"(.+)={_NUMBER}:{_NUMBER}", text)):
        raise ModsimError(f"--expect: needs SCORE=MEAN:SPREAD, as in hota=0.7:0.05 (got '{text[:60]}')")
    name, expectation = match[1], Expectation(float(match[2]), float(match[3]))
    if not expectation.spread > 0:
        raise ModsimError(f"--expect {name}: needs a spread above 0 (got {expectation.spread:g})")
    names = list(dict.fromkeys(requirement.what for requirement in plan.keys.require if requirement.share is None))
    if name not in names:
        raise ModsimError(f"--expect: no requirement is on the mean of '{name}' ({nearest(name, names)})")
    return name, expectation


def needed_seeds(plan: Plan, expected: Mapping[str, Expectation], like: CampaignFolder | None) -> list[NeededSeeds]:
    """Seeds that each requirement needs, by tracker and condition where these differ. `expected` maps the name of a
    score, or of a difference of it, to what is expected; else the scores of an earlier campaign `like` are expected."""
    rows = None if like is None else SeedRows(like.plan, results_table(like))
    needs, verdicts = [], len(wording.cases_of_all(plan))
    for place in dict.fromkeys(place for place, _ in wording.cases_of_all(plan)):
        requirement, by_case = wording.at_step(plan, place, verdicts, 0), []
        for case in cases_of(plan, requirement):
            prior = expected.get(requirement.what)
            if prior is None and like is not None and rows is not None:
                prior = _earlier_scores(plan, case, requirement, like.plan, rows)
            label = " − ".join(labels_of(plan, case))
            empty = NeededSeeds(place, wording.requirement_text(requirement, case.within), label, case.condition)
            by_case.append(_with_seeds(empty, plan, requirement, case, prior if requirement.share is None else None))
        if len(by_case) > 1 and len({(one.seeds, one.why) for one in by_case}) == 1:
            by_case = [replace(by_case[0], tracker=None, condition=None)]
        needs += by_case
    return needs


def _with_seeds(
    empty: NeededSeeds, plan: Plan, requirement: Requirement, case: Case, expected: Expectation | None
) -> NeededSeeds:
    share, sure, once = requirement.share, requirement.confidence, plan.keys.stop == "once"
    endless = plan.keys.model_copy(update={"seeds": Seeds(traffic=MAX_SEEDS)})
    if reason := wording.never_met(endless, requirement, case.group):
        return replace(empty, why=f"never: {reason}")
    if requirement.known_at_m is not None:
        return replace(empty, why="unknown: it rests on approaches, and seeds differ in their number")
    if share is not None and not once:
        return replace(empty, seeds=bounds.clean_seeds_sequential(share, sure), why="if all are right")
    if share is not None:
        clean, more = (bounds.clean_seeds(share, sure, wrong) for wrong in (0, 1))
        return replace(empty, seeds=clean, why=f"if all are right; {more:,} if one is not")
    least = int(wording.offered_from(requirement, case.group)) if once else 1
    if expected is None:
        why = f"unknown, {least} or more: it needs --expect '{requirement.what}=MEAN:SPREAD', or --like DIR that has it"
        return replace(empty, why=why)
    need = replace(empty, expected=expected)
    if not requirement.holds(expected.mean) or expected.mean == requirement.threshold:
        side = "above" if requirement.at_least is not None else "below"
        cause = f"the expected mean, {wording.rounded(expected.mean)}, is not {side} {requirement.threshold:g}"
        return replace(need, why=f"never: {cause}")
    if not expected.spread > 0:
        return replace(need, why="never: equal values show nothing of a mean: ask for a share of seeds with `in`")
    seeds = (_one_look if once else _sequential)(expected, requirement, limits_of(requirement, plan.keys.score), least)
    why = f"for a mean of {wording.rounded(expected.mean)} and a spread of {wording.rounded(expected.spread)}"
    why += f", {counted(expected.lost, 'lost run')} of it left out" * (expected.lost > 0)
    return replace(need, seeds=seeds, why=why if seeds else f"more than {_MAX_SEEDS:,} {why}")


def _earlier_scores(plan: Plan, case: Case, requirement: Requirement, like: Plan, rows: SeedRows) -> Expectation | None:
    """Mean and spread of an earlier campaign, of the same trackers and values; None with fewer than two seeds."""
    labels, condition = [entry.label for entry in like.keys.trackers], plan.conditions[case.condition]
    wanted = condition.values, value_of(condition, SCENE)
    same = [place for place, other in enumerate(like.conditions) if (other.values, value_of(other, SCENE)) == wanted]
    if not same or not set(labels_of(plan, case)) <= set(labels):
        return None
    tracker, *minus = (labels.index(label) for label in labels_of(plan, case))
    runs = rows.runs_of(Case(tracker, same[0], case.part, *minus), requirement.score, requirement.resting_on)
    means = runs.means(math.nan)
    means = means[np.isfinite(means)]
    return Expectation(float(means.mean()), float(means.std(ddof=1)), int(runs.lost.sum())) if len(means) > 1 else None


def _one_look(expected: Expectation, requirement: Requirement, limits: tuple[float, float], least: int) -> int:
    """The least number of normal values with which the bound of a verdict is beyond the threshold with `POWER`."""
    sign = 1 if requirement.at_least is not None else -1
    greatest = limits[1] if sign > 0 else -limits[0]

    def enough(seeds: int) -> bool:
        rng = np.random.default_rng(1)
        mean = sign * expected.mean + expected.spread / math.sqrt(seeds) * rng.standard_normal(_DRAWN)
        skewness = math.sqrt(6 * (seeds - 2) / ((seeds + 1) * (seeds + 3))) * rng.standard_normal(_DRAWN)
        deviation = expected.spread * np.sqrt(rng.chisquare(seeds - 1, _DRAWN) / (seeds - 1))
        mean = np.minimum(mean, np.nextafter(greatest, -math.inf))
        low = bounds.corrected_bounds(mean, deviation, skewness, seeds, 1 - requirement.confidence, greatest)
        return float(np.mean(low >= sign * requirement.threshold)) >= POWER

    return bounds.least_whole(enough, max(least, 3))


def _sequential(expected: Expectation, requirement: Requirement, limits: tuple[float, float], least: int) -> int | None:
    """After how many normal values, cut to what the score can be, `POWER` of the sequences are met."""
    start, end = limits if requirement.at_least is not None else reversed(limits)
    rng, wealth, first = np.random.default_rng(1), -math.log1p(-requirement.confidence), []
    for _ in range(_DRAWN_SEQUENTIAL):
        values = np.clip((rng.normal(expected.mean, expected.spread, _MAX_SEEDS) - start) / (end - start), 0, 1)
        met = np.flatnonzero(bounds.log_capital(values, (requirement.threshold - start) / (end - start)) >= wealth)
        first.append(max(met[0] + 1, least) if len(met) else math.inf)
    seeds = float(np.quantile(first, POWER, method="inverted_cdf"))
    return int(seeds) if math.isfinite(seeds) else None
