"""The folder of a search: the points of each batch while it is under way, and all trials at the end.

The trials lie in `search/` and never in `results/`: they are chosen to be bad, so no rate may be made of them.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.campaign.file.keys import Range, SearchKeys
from modsim3d.campaign.plan.plan import PlannedRun
from modsim3d.campaign.plan.seeds import traffic_seed
from modsim3d.campaign.results.done_rows import text_of
from modsim3d.campaign.results.ended import SEARCH, write_list
from modsim3d.campaign.results.folder import FILE, CampaignFolder, opened_campaign
from modsim3d.campaign.search.space import Point
from modsim3d.campaign.search.trials import planned_trial, told_apart
from modsim3d.campaign.work.row import table_of
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.campaign.work.task import PLAN, Task, read_rows
from modsim3d.errors import ModsimError, OutputError
from modsim3d.outputs.placing import make_folder, sync_file, sync_folder, write_files
from modsim3d.paths import StrPath

_PART = "part-00000.parquet"
VALUES = "values"
"""Column with the values of the keys that were searched, as JSON."""


def search_ended(folder: CampaignFolder) -> bool:
    """Whether all trials are written."""
    return (folder.path / SEARCH).is_dir()


def stored_batch(folder: CampaignFolder, batch: int) -> list[Point] | None:
    """The points of a batch that was proposed before; None if it was not."""
    path = _batch_file(folder, batch)
    if not path.is_file():
        return None
    try:
        return [Point(each["seed"], each["places"]) for each in orjson.loads(path.read_bytes())]
    except (OSError, ValueError, KeyError, TypeError):
        return None  # damaged: it is proposed again


def store_batch(folder: CampaignFolder, batch: int, points: Sequence[Point]) -> None:
    """Write the points of a batch.

    Raises:
        OutputError: They cannot be written.
    """
    content = [{"seed": point.seed_index, "places": dict(point.places)} for point in points]
    write_files({_batch_file(folder, batch): orjson.dumps(content)})


def done_row(task: Task) -> dict[str, Any] | None:
    """The row of a task of one run; None if it is not done, or its file is damaged."""
    table = read_rows(task.path)
    if table is None:
        return None
    row: dict[str, Any] = table.to_pylist()[0]
    return row


def trials_table(runs: Sequence[PlannedRun], rows: Sequence[Mapping[str, Any]], search: SearchKeys) -> pa.Table:
    """The table of trials: `status` is `done`, `crashed` or `refused`; `values` holds the keys that were searched.

    Args:
        runs: The trials in their order.
        rows: What came of each.
        search: The search.
    """
    table = table_of(rows)
    columns: dict[str, Any] = {
        "scene": pa.array([Path(run.condition.scene).stem for run in runs], pa.string()),
        "condition": pa.array([run.condition_index for run in runs], pa.int64()),
        "traffic_seed": pa.array([run.traffic_seed for run in runs], pa.int64()),
        "detector_seed": pa.array([run.detector_seed for run in runs], pa.int64()),
        "tracker": pa.array([run.tracker.label for run in runs], pa.string()),
        **{key: _column([run.condition.values[key] for run in runs], each) for key, each in search.over.items()},
        VALUES: pa.array(
            [orjson.dumps({key: run.condition.values[key] for key in search.over}).decode() for run in runs]
        ),
    }
    return pa.table({"run": table["run"], **columns, **{each: table[each] for each in table.column_names[1:]}})


def write_trials(folder: CampaignFolder, table: pa.Table) -> None:
    """Write the trials of a search that ended.

    Raises:
        OutputError: They cannot be written.
    """
    final = folder.path / SEARCH
    partial = folder.path / f".{SEARCH}.partial"
    try:
        shutil.rmtree(partial, ignore_errors=True)
        make_folder(partial)
        pq.write_table(table, partial / _PART, compression="zstd", write_page_checksum=True)
        sync_file(partial / _PART)
        write_list(folder.path, partial, SEARCH, (FILE, PLAN), {})
        sync_folder(partial)
        partial.rename(final)
        sync_folder(folder.path)
    except OSError as error:
        raise OutputError(f"{final} cannot be written: {error.strerror or error}") from error


def search_table(folder: CampaignFolder) -> pa.Table:
    """The trials of a search in their order: all, or those that are done so far.

    Raises:
        ModsimError: It is no search, or its trials are damaged.
    """
    search = searched(folder)
    if search_ended(folder):
        return pq.read_table(folder.path / SEARCH / _PART, partitioning=None)
    scenes = Scenes(folder.keys.steps, Path(folder.facts["base"]))
    runs, rows = [], []
    for run in stored_trials(folder):
        if (row := done_row(Task(folder.work, (run,)))) is not None:
            runs.append(run)
            rows.append(told_apart(row, run, scenes))
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
    """The run of a trial, for making it again.

    Args:
        folder: The folder of a search.
        number: Number of the trial, from 0.

    Raises:
        ModsimError: It is no folder of a search, it is damaged, or it has no such trial.
        TypeError: The folder is neither text nor a path.
    """
    found = opened_campaign(folder)
    searched(found)
    if not search_ended(found):
        runs = stored_trials(found)
        if 0 <= number < len(runs):
            return runs[number]
        raise ModsimError(_no_trial(found, number, len(runs)))
    table = search_table(found)
    row = table.filter(pc.equal(table["run"], number)).select(["traffic_seed", VALUES]).to_pylist()
    if not row:
        raise ModsimError(_no_trial(found, number, len(table)))
    seed_index = row[0]["traffic_seed"] - traffic_seed(found.keys.seed, 0)
    return planned_trial(found.plan, number, seed_index, orjson.loads(row[0][VALUES]))


def searched(folder: CampaignFolder) -> SearchKeys:
    """The search of a campaign.

    Raises:
        ModsimError: It has none.
    """
    if folder.keys.search is None:
        raise ModsimError(f"{folder.path} holds a campaign without a search")
    return folder.keys.search


def batches(search: SearchKeys) -> int:
    """Number of batches."""
    return -(-search.budget // search.batch)


def _batch_file(folder: CampaignFolder, batch: int) -> Path:
    return folder.done / f"batch-{batch:06d}.json"


def _no_trial(folder: CampaignFolder, number: int, count: int) -> str:
    there = f"0 to {count - 1}" if count else "none yet"
    return f"{folder.path} has no trial {number} (there: {there})"


def _column(values: Sequence[Any], each: Range) -> pa.Array:
    """Numbers as numbers, and choices of another kind as text."""
    if each.choices is None:
        return pa.array(values, pa.int64() if each.whole else pa.float64())
    if all(isinstance(choice, int | float) and not isinstance(choice, bool) for choice in each.choices):
        return pa.array([float(value) for value in values], pa.float64())
    return pa.array([None if value is None else text_of(value) for value in values], pa.string())
