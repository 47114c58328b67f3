"""The rows that are done, and the data set that is made of them at the end."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.arrays import Indices
from modsim3d.campaign.plan.plan import Plan
from modsim3d.campaign.results.folder import FORMAT, VERDICTS, CampaignFolder
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.row import DONE, FACTS, SCORES, table_of
from modsim3d.errors import ModsimError
from modsim3d.outputs.placing import make_folder, sync_file, sync_folder, write_files

PART_ROWS = 50_000
"""Rows of a file of the data set: they follow the plan, whoever made them."""


def done_rows(folder: CampaignFolder) -> pa.Table:
    """The rows that are done, one for each run in the order of the plan, with the columns of the plan.

    Of a run that is there twice, a row that did not crash counts.
    """
    parts = [_read(path) for path in sorted(folder.done.glob("[0-9]*.parquet"))] if folder.done.is_dir() else []
    table = pa.concat_tables([part for part in parts if part is not None] or [table_of([])], promote_options="default")
    others = sorted(set(table.column_names) - {*FACTS, *SCORES})
    table = table.select([*FACTS, *SCORES, *others])
    crashed = pc.not_equal(table["status"], DONE)
    order = pc.sort_indices(table.append_column("crashed", crashed), [("run", "ascending"), ("crashed", "ascending")])
    table = table.take(order)
    numbers = table["run"].to_numpy()
    table = table.filter(np.diff(numbers, prepend=-1) > 0)
    return with_plan(table, folder.plan)


def with_plan(table: pa.Table, plan: Plan) -> pa.Table:
    """The table with what the plan says of each run after its number."""
    runs = plan.runs(table["run"].to_pylist())
    columns: dict[str, Any] = {
        "scene": [Path(run.condition.scene).stem for run in runs],
        "condition": pa.array([run.condition_index for run in runs], pa.int64()),
        "traffic_seed": pa.array([run.traffic_seed for run in runs], pa.int64()),
        "detector_seed": pa.array([run.detector_seed for run in runs], pa.int64()),
        "tracker": pa.array([run.tracker.label for run in runs], pa.string()),
        **{
            name: _values([run.condition.values.get(name) for run in runs], plan, name)
            for name in plan.parameters
            if name != "scene"
        },
    }
    columns["scene"] = pa.array(columns["scene"], pa.string())
    found = {"run": table["run"], **columns, **{name: table[name] for name in table.column_names if name != "run"}}
    return pa.table(found)


def _values(values: Sequence[Any], plan: Plan, name: str) -> pa.Array:
    """A column of values of a key: numbers if all that the plan has are numbers, else text."""
    known = [condition.values[name] for condition in plan.conditions if name in condition.values]
    if all(
        isinstance(value, int | float) and not isinstance(value, bool)
        for value in [*known, *values]
        if value is not None
    ):
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else text_of(value) for value in values], pa.string())


def text_of(value: Any) -> str:
    """A value of a key as a table shows it."""
    return value if isinstance(value, str) else orjson.dumps(value).decode()


def write_results(folder: CampaignFolder, table: pa.Table) -> None:
    """Write the data set, `results/scene=NAME/part-N.parquet`, and remove the files of tasks.

    Args:
        folder: The campaign.
        table: The rows that count, in the order of the plan.

    Raises:
        OutputError: It cannot be written.
    """
    partial = folder.path / f".{folder.results.name}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    for name in dict.fromkeys(table["scene"].to_pylist()):
        rows = table.filter(pc.equal(table["scene"], name)).drop_columns(["scene"])
        place = partial / f"scene={name}"
        make_folder(place)
        for number, first in enumerate(range(0, len(rows), PART_ROWS)):
            path = place / f"part-{number:05d}.parquet"
            pq.write_table(rows.slice(first, PART_ROWS), path, compression="zstd", row_group_size=PART_ROWS)
            sync_file(path)
    sync_folder(partial)
    partial.rename(folder.results)
    sync_folder(folder.path)
    shutil.rmtree(folder.done, ignore_errors=True)


def write_verdicts(folder: CampaignFolder, verdicts: Sequence[Verdict]) -> None:
    """Write `verdicts.json`.

    Raises:
        OutputError: It cannot be written.
    """
    content = {"format": FORMAT, "sha256": folder.facts["sha256"], "verdicts": [asdict(each) for each in verdicts]}
    write_files({folder.path / VERDICTS: orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)})


def results_table(folder: CampaignFolder) -> pa.Table:
    """The rows of a campaign in the order of its plan: its results, or what is done so far."""
    if not folder.finished:
        return done_rows(folder)
    parts = []
    for path in sorted(folder.results.glob("scene=*/part-*.parquet")):
        try:
            part = pq.read_table(path, partitioning=None)
        except (OSError, pa.ArrowInvalid) as error:
            raise ModsimError(f"{path} is damaged: {error}") from None
        scene = pa.array([path.parent.name.partition("=")[2]] * len(part), pa.string())
        parts.append(part.add_column(1, "scene", scene))
    return pa.concat_tables(parts, promote_options="default").sort_by("run")


def done_numbers(folder: CampaignFolder) -> Indices:
    """The runs whose rows are there, ascending, shape (n,)."""
    numbers = set[int]()
    for path in folder.done.glob("[0-9]*.parquet") if folder.done.is_dir() else ():
        numbers |= set(_numbers(path))
    return np.array(sorted(numbers), dtype=np.int64)


def _numbers(path: Path) -> list[int]:
    part = _read(path, ["run"])
    return [] if part is None else part["run"].to_pylist()


def _read(path: Path, columns: list[str] | None = None) -> pa.Table | None:
    try:
        return pq.read_table(path, columns=columns, partitioning=None).replace_schema_metadata(None)
    except (OSError, pa.ArrowInvalid):
        return None
