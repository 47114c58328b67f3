"""The files of a campaign, which commands read and never write over."""

from __future__ import annotations

from pathlib import Path

from modsim3d.campaign.results.folder import FILE, CampaignFolder
from modsim3d.campaign.work.task import ROWS_PATTERN


def files_of_campaign(folder: CampaignFolder) -> list[Path]:
    """Its file, its plan, its verdicts and its rows."""
    rows = [folder.results.glob("scene=*/part-*.parquet"), folder.done.glob(ROWS_PATTERN)]
    return [folder.path / FILE, *sorted(folder.path.glob("*.json")), *(path for each in rows for path in sorted(each))]
