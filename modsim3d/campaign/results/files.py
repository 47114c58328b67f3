"""The files of a campaign, which commands read and never write over."""

from __future__ import annotations

from pathlib import Path

from modsim3d.campaign.results.ended import LIST, RESULTS, SEARCH
from modsim3d.campaign.results.folder import FILE, CampaignFolder
from modsim3d.campaign.work.task import ROWS_PATTERN


def files_of_campaign(folder: CampaignFolder) -> list[Path]:
    """Its file, its plan, its verdicts, its rows or trials, and the list of all these."""
    patterns = ("*.json", f"{RESULTS}/scene=*/part-*.parquet", f"{SEARCH}/*.parquet", f"*/{LIST}")
    found = [path for pattern in patterns for path in sorted(folder.path.glob(pattern))]
    return [folder.path / FILE, *found, *sorted(folder.done.glob(ROWS_PATTERN))]
