"""A run of a campaign, made again from the campaign's folder."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.campaign.plan.plan import PlannedRun
from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.results.gather import results_table
from modsim3d.campaign.work.layers import Layers, Made
from modsim3d.errors import ModsimError


def planned_run(folder: CampaignFolder, number: int) -> PlannedRun:
    """What the plan says of a run.

    Raises:
        ModsimError: The campaign has no such run, or is a search, whose trials are no runs of the plan.
    """
    if folder.keys.search is not None:
        raise ModsimError(f"{folder.path} holds a search: its trials cannot be made again")
    if not 0 <= number < len(folder.plan):
        raise ModsimError(f"{folder.path} has runs 0 to {len(folder.plan) - 1} (got {number})")
    return folder.plan.run(number)


def row_of_run(folder: CampaignFolder, number: int) -> dict[str, Any] | None:
    """The row of a run; None if it is not done.

    Raises:
        ModsimError: The results are damaged.
    """
    if not folder.finished:
        table = results_table(folder)
        found = table.filter(pc.equal(table["run"], number)).to_pylist()
        return found[0] if found else None
    for path in sorted(folder.results.glob("scene=*/part-*.parquet")):
        try:
            rows = pq.read_table(path, partitioning=None, filters=[("run", "==", number)]).to_pylist()
        except (OSError, ValueError) as error:
            raise ModsimError(f"{path} is damaged: {error}") from None
        if rows:
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
