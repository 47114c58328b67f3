"""The folder of a search: the points of each batch while it is under way, and all trials at the end. The trials lie in
`search/` and never in `results/`: they are chosen to be bad, so no rate may be made of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.campaign.done_rows import with_columns, write_rows
from modsim3d.campaign.folder import SEARCH, CampaignFolder, opened_campaign, results_folder
from modsim3d.campaign.keys import Range, SearchKeys
from modsim3d.campaign.plan import Plan, PlannedRun, detector_seed, traffic_seed, value_column
from modsim3d.campaign.running import DIED
from modsim3d.campaign.work.row import CRASHED, DONE, table_of
from modsim3d.campaign.work.scenes import Scenes, digest, tracker_of
from modsim3d.campaign.work.task import Task, read_rows
from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath
from modsim3d.io.atomic_write import write_files

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial

SEED = "traffic seed"  # name of the dimension of the traffic seed; no key of a scene has a space in it


@dataclass(frozen=True)
class Point:
    """A point of the space that is searched."""

    seed_index: int  # number of the traffic seed, from 0
    places: Mapping[str, float | int]  # number of each key, or index of its choice

    def values(self, ranges: Mapping[str, Range]) -> dict[str, Any]:
        """The values of the keys."""
        places = ((key, span.choices, self.places[key]) for key, span in ranges.items())
        return {key: place if choices is None else choices[int(place)] for key, choices, place in places}


def distributions(search: SearchKeys) -> dict[str, BaseDistribution]:
    """Dimensions as Optuna knows them. Traffic seeds are categories: neighbouring numbers have nothing in common."""
    from optuna.distributions import CategoricalDistribution

    by_key = {key: _distribution(span) for key, span in search.over.items()}
    return {**by_key, SEED: CategoricalDistribution(range(search.seeds))} if search.seeds > 1 else by_key


def point_of(parameters: Mapping[str, Any], search: SearchKeys) -> Point:
    """Point that Optuna proposes, without the last digits, which depend on the processor."""
    places = {key: _rounded(span, parameters[key]) for key, span in search.over.items()}
    return Point(int(parameters.get(SEED, 0)), places)


def parameters_of(point: Point, search: SearchKeys) -> dict[str, Any]:
    """The point as Optuna knows it."""
    return {**point.places, SEED: point.seed_index} if search.seeds > 1 else dict(point.places)


def _distribution(values: Range) -> BaseDistribution:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if values.choices is not None:
        return CategoricalDistribution(range(len(values.choices)))
    assert values.low is not None and values.high is not None
    log = values.scale == "log"
    if values.whole:
        return IntDistribution(int(values.low), int(values.high), log=log)
    return FloatDistribution(values.low, values.high, log=log)


def _rounded(values: Range, place: float | int) -> float | int:
    if values.choices is not None or values.whole:
        return int(place)
    assert values.low is not None and values.high is not None
    return min(max(float(f"{place:.12g}"), float(values.low)), float(values.high))


@dataclass(frozen=True)
class TriedPoint:
    """A point and what came of it."""

    point: Point
    value: float | None  # the score; None if the scene refuses the point, or there is nothing to be scored
    crashed: bool = False


def proposed(search: SearchKeys, seed: int, batch: int, tried: Sequence[TriedPoint]) -> list[Point]:
    """Points of a batch, where `tried` has all points of the batches before it. The points of one batch keep away from
    each other: each counts as bad until its score is known (`constant_liar`). The estimator avoids points without a
    score. Crashed runs do not steer it, or the rest of the budget would be spent on one crash."""
    import optuna

    space = distributions(search)
    own_seed = int(digest("search", seed, batch)[:8], 16)
    with _silence():
        study = optuna.create_study(
            direction="minimize" if search.minimise is not None else "maximize",
            sampler=optuna.samplers.TPESampler(seed=own_seed, multivariate=True, constant_liar=True),
        )
    study.add_trials([_trial(point, search) for point in tried])
    count = min(search.batch, search.budget - batch * search.batch)
    return [point_of(study.ask(space).params, search) for _ in range(count)]


def _trial(tried: TriedPoint, search: SearchKeys) -> FrozenTrial:
    from optuna.trial import TrialState, create_trial

    scored = TrialState.PRUNED if tried.value is None else TrialState.COMPLETE
    state = TrialState.FAIL if tried.crashed else scored
    return create_trial(
        state=state,
        value=tried.value if state is TrialState.COMPLETE else None,
        params=parameters_of(tried.point, search),
        distributions=distributions(search),
    )


@contextmanager
def _silence() -> Iterator[None]:
    from optuna import logging

    before = logging.get_verbosity()
    logging.set_verbosity(logging.WARNING)
    try:
        yield
    finally:
        logging.set_verbosity(before)


# ---- A trial of a search as a planned run, and what its row says ----

REFUSED = "refused"  # status of a trial whose values scene, detector or tracker do not take: no failure of the tracker


def score_of(search: SearchKeys) -> str:
    """The score that is searched by."""
    score = search.minimise or search.maximise
    assert score is not None
    return score


def planned_trial(plan: Plan, number: int, seed_index: int, values: Mapping[str, Any]) -> PlannedRun:
    """Run of a trial of a plan with one condition and one tracker; `values` are those of the keys that are searched."""
    traffic = traffic_seed(plan.keys.seed, seed_index)
    condition = plan.conditions[0].with_values(values)
    return PlannedRun(number, seed_index, 0, condition, traffic, detector_seed(traffic, 0), plan.keys.trackers[0])


def refusal(run: PlannedRun, scenes: Scenes) -> str | None:
    """Reason why a run cannot even begin; None if it can."""
    try:
        scene = scenes.of(run.condition, run.traffic_seed, run.detector_seed)
        tracker_of(run.tracker, run.condition.of_tracker(), scene.name, scenes.folder)
    except ModsimError as error:
        return str(error)
    except Exception:  # of a plug-in: a crash
        return None
    return None


def trial_row(row: Mapping[str, Any], run: PlannedRun, scenes: Scenes) -> dict[str, Any]:
    """The row of a trial, in which a refused one is told apart from a crash."""
    alive = row["error"] != DIED  # what ended a worker is not tried in this process
    if row["status"] == CRASHED and alive and (reason := refusal(run, scenes)) is not None:
        return {**row, "status": REFUSED, "error": reason}
    return dict(row)


def tried(point: Point, row: Mapping[str, Any], search: SearchKeys) -> TriedPoint:
    """Result at a point of the search."""
    value = row.get(score_of(search)) if row["status"] == DONE else None
    known = value is not None and math.isfinite(value)
    return TriedPoint(point, value if known else None, row["status"] == CRASHED)


VALUES = "values"  # column with the values of the keys that were searched, as JSON


def stored_batch(folder: CampaignFolder, batch: int) -> list[Point] | None:
    """The points of a batch that was proposed before; None if it was not."""
    path = _batch_file(folder, batch)
    if not path.is_file():
        return None
    try:
        return [Point(point["seed"], point["places"]) for point in orjson.loads(path.read_bytes())]
    except (OSError, ValueError, KeyError, TypeError):
        return None  # damaged: it is proposed again


def store_batch(folder: CampaignFolder, batch: int, points: Sequence[Point]) -> None:
    """Write the points of a batch; OutputError if they cannot be written."""
    content = [{"seed": point.seed_index, "places": dict(point.places)} for point in points]
    write_files({_batch_file(folder, batch): orjson.dumps(content)})


def done_row(task: Task) -> dict[str, Any] | None:
    """The row of a task of one run; None if it is not done, or its file is damaged."""
    table = read_rows(task.path)
    return None if table is None else table.to_pylist()[0]


def trials_table(runs: Sequence[PlannedRun], rows: Sequence[Mapping[str, Any]], search: SearchKeys) -> pa.Table:
    """Table of trials: `status` is `done`, `crashed` or `refused`; `values` holds the keys that were searched."""
    values = [{key: run.condition.values[key] for key in search.over} for run in runs]
    columns = {key: _column([point[key] for point in values], span) for key, span in search.over.items()}
    columns[VALUES] = pa.array([orjson.dumps(point).decode() for point in values])
    return with_columns(table_of(rows), runs, columns)


def write_trials(folder: CampaignFolder, table: pa.Table) -> None:
    """Write the trials of a search that ended; OutputError if they cannot be written."""
    with results_folder(folder.path, SEARCH, {}) as partial:
        write_rows(partial, table)


def search_table(folder: CampaignFolder) -> pa.Table:
    """Trials of a search that are done, in order. Raises ModsimError if it is no search, or they are damaged."""
    search = searched(folder)
    if folder.finished:
        return pq.read_table(folder.path / SEARCH, partitioning=None)
    scenes = Scenes(folder.keys.steps, Path(folder.facts["base"]))
    runs, rows = [], []
    for run in stored_trials(folder):
        if (row := done_row(Task(folder.work, (run,)))) is not None:
            runs.append(run)
            rows.append(trial_row(row, run, scenes))
    return trials_table(runs, rows, search)


def stored_trials(folder: CampaignFolder) -> list[PlannedRun]:
    """The trials that were proposed so far, of a search that is under way."""
    search, runs = searched(folder), list[PlannedRun]()
    for batch in range(batches(search)):
        if (points := stored_batch(folder, batch)) is None:
            break
        runs += planned_batch(folder, batch, points)
    return runs


def planned_batch(folder: CampaignFolder, batch: int, points: Sequence[Point]) -> list[PlannedRun]:
    """The trials of a batch."""
    search = searched(folder)
    return [
        planned_trial(folder.plan, batch * search.batch + place, point.seed_index, point.values(search.over))
        for place, point in enumerate(points)
    ]


def trial_run(folder: StrPath, number: int) -> PlannedRun:
    """Run of a trial, for making it again. Raises ModsimError if this is no folder of a search, it is damaged, or it
    has no such trial, and TypeError if it is neither text nor a path."""
    campaign = opened_campaign(folder)
    searched(campaign)
    if not campaign.finished:
        runs = stored_trials(campaign)
        if 0 <= number < len(runs):
            return runs[number]
        raise ModsimError(_no_trial(campaign, number, len(runs)))
    table = search_table(campaign)
    row = table.filter(pc.equal(table["run"], number)).select(["traffic_seed", VALUES]).to_pylist()
    if not row:
        raise ModsimError(_no_trial(campaign, number, len(table)))
    seed_index = row[0]["traffic_seed"] - traffic_seed(campaign.keys.seed, 0)
    return planned_trial(campaign.plan, number, seed_index, orjson.loads(row[0][VALUES]))


def searched(folder: CampaignFolder) -> SearchKeys:
    """Search of a campaign; ModsimError if it has none."""
    if folder.keys.search is None:
        raise ModsimError(f"{folder.path} holds a campaign without a search")
    return folder.keys.search


def batches(search: SearchKeys) -> int:
    """Number of batches."""
    return -(-search.budget // search.batch)


def _batch_file(folder: CampaignFolder, batch: int) -> Path:
    return folder.done / f"batch-{batch:06d}.json"


def _no_trial(folder: CampaignFolder, number: int, count: int) -> str:
    numbers = f"0 to {count - 1}" if count else "none yet"
    return f"{folder.path} has no trial {number} (there: {numbers})"


def _column(values: Sequence[Any], span: Range) -> pa.Array:
    if span.choices is None:
        return pa.array(values, pa.int64() if span.whole else pa.float64())
    return value_column(values, span.choices)
