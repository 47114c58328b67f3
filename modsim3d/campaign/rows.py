"""The rows of a campaign, whether it follows a plan or searches."""

from __future__ import annotations

import pyarrow as pa

from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.results.gather import results_table
from modsim3d.campaign.search.folder import search_ended, search_table


def rows_of(folder: CampaignFolder) -> pa.Table:
    """The runs or trials of a campaign in their order: all, or those that are done so far.

    Raises:
        ModsimError: They are damaged.
    """
    return results_table(folder) if folder.keys.search is None else search_table(folder)


def has_ended(folder: CampaignFolder) -> bool:
    """Whether all of them are written."""
    return folder.finished if folder.keys.search is None else search_ended(folder)


def planned_rows(folder: CampaignFolder) -> int:
    """How many there are at most."""
    return len(folder.plan) if folder.keys.search is None else folder.keys.search.budget
