"""A run of a campaign, made again from the campaign's folder."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.campaign.plan.plan import PlannedRun
from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.results.sources import check_files
from modsim3d.campaign.rows import rows_of
from modsim3d.campaign.search.folder import trial_run
from modsim3d.campaign.work.layers import Layers, Made
from modsim3d.errors import ModsimError


def planned_run(folder: CampaignFolder, number: int) -> PlannedRun:
    """What the plan says of a run, or the search of a trial.

    Raises:
        InputError: A file that the run is made of is not as it was.
        ModsimError: The campaign has no such run.
    """
    check_files(folder)
    if folder.keys.search is not None:
        return trial_run(folder.path, number)
    if not 0 <= number < len(folder.plan):
        raise ModsimError(f"{folder.path} has runs 0 to {len(folder.plan) - 1} (got {number})")
    return folder.plan.run(number)


def row_of_run(folder: CampaignFolder, number: int) -> dict[str, Any] | None:
    """The row of a run; None if it is not done.

    Raises:
        ModsimError: The results are damaged.
    """
    if not folder.finished:  # or a search
        table = rows_of(folder)
        found = table.filter(pc.equal(table["run"], number)).to_pylist()
        return found[0] if found else None
    for path in sorted(folder.results.glob("scene=*/part-*.parquet")):
        if rows := pq.read_table(path, partitioning=None, filters=[("run", "==", number)]).to_pylist():
            return {"scene": path.parent.name.partition("=")[2], **rows[0]}
    return None


def remade(folder: CampaignFolder, number: int) -> Made:
    """All layers of a run, made again or read where they are kept.

    Raises:
        ModsimError: There is no such run, or it fails.
    """
    run, work = planned_run(folder, number), folder.work
    with closing(Layers(work.keys.model_copy(update={"keep": []}), Path(work.base), work.layers)) as layers:
        return layers.made(run)
