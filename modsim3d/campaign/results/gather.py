"""The rows that are done, and the data set that is made of them at the end."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import orjson
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.campaign.results.done_rows import DoneRows
from modsim3d.campaign.results.ended import RESULTS, write_list
from modsim3d.campaign.results.folder import FILE, FORMAT, VERDICTS, CampaignFolder
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.task import PLAN
from modsim3d.errors import OutputError
from modsim3d.outputs.placing import make_folder, sync_file, sync_folder, write_files

PART_ROWS = 50_000
"""Rows of a file of the data set: they follow the plan, whoever made them."""


def done_rows(folder: CampaignFolder) -> pa.Table:
    """The rows that are done, one for each run in the order of the plan, with the columns of the plan."""
    return DoneRows(folder).read().table()


def write_results(folder: CampaignFolder, table: pa.Table, verdicts: Sequence[Verdict]) -> None:
    """Write the data set, `results/scene=NAME/part-N.parquet`; it gets its name when it is whole.

    With it comes the list of all files of the campaign, see `check_ended`.

    On a file system without locks another process may do the same; whoever comes second leaves the first one's.

    Args:
        folder: The campaign.
        table: The rows that count, in the order of the plan.
        verdicts: The verdicts on them, which are written afterwards.

    Raises:
        OutputError: It cannot be written.
    """
    partial = folder.path / f".{folder.results.name}.{uuid.uuid4().hex}"
    try:
        make_folder(partial)
        for name in dict.fromkeys(table["scene"].to_pylist()):
            rows = table.filter(pc.equal(table["scene"], name)).drop_columns(["scene"])
            _write_scene(partial / f"scene={name}", rows)
        write_list(folder.path, partial, RESULTS, (FILE, PLAN), {VERDICTS: _content_of(folder, verdicts)})
        sync_folder(partial)
        partial.rename(folder.results)
        sync_folder(folder.path)
    except OSError as error:
        if not folder.finished:
            raise OutputError(f"{folder.results} cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _write_scene(folder: Path, rows: pa.Table) -> None:
    make_folder(folder)
    for number, first in enumerate(range(0, len(rows), PART_ROWS)):
        path, part = folder / f"part-{number:05d}.parquet", rows.slice(first, PART_ROWS)
        pq.write_table(part, path, compression="zstd", row_group_size=PART_ROWS, write_page_checksum=True)
        sync_file(path)
    sync_folder(folder)


def remove_done(folder: CampaignFolder) -> None:
    """Remove the files of tasks of a campaign whose results are there, and results that were half written.

    The folder of tasks gets another name first: a worker that still writes a row cannot bring it back.
    """
    for partial in folder.path.glob(f".{folder.results.name}.*"):
        shutil.rmtree(partial, ignore_errors=True)
    leaving = folder.path / f".{folder.done.name}.removed"
    shutil.rmtree(leaving, ignore_errors=True)
    with suppress(OSError):  # it is not there
        folder.done.rename(leaving)
    shutil.rmtree(leaving, ignore_errors=True)


def write_verdicts(folder: CampaignFolder, verdicts: Sequence[Verdict]) -> None:
    """Write `verdicts.json`.

    Raises:
        OutputError: It cannot be written.
    """
    write_files({folder.path / VERDICTS: _content_of(folder, verdicts)})


def _content_of(folder: CampaignFolder, verdicts: Sequence[Verdict]) -> bytes:
    fixed = [not each["traffic_has_seed"] for each in folder.facts["conditions"]]
    content = {
        "format": FORMAT,
        "sha256": folder.facts["sha256"],
        "verdicts": [{**asdict(each), "this_traffic_only": fixed[each.condition]} for each in verdicts],
    }
    return orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def results_table(folder: CampaignFolder) -> pa.Table:
    """The rows of a campaign in the order of its plan: its results, or what is done so far."""
    if not folder.finished:
        return done_rows(folder)
    parts = []
    for path in sorted(folder.results.glob("scene=*/part-*.parquet")):
        part = pq.read_table(path, partitioning=None)
        scene = pa.array([path.parent.name.partition("=")[2]] * len(part), pa.string())
        parts.append(part.add_column(1, "scene", scene))
    return pa.concat_tables(parts, promote_options="default").sort_by("run")
