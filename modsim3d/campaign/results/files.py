"""The files of a campaign, which commands read and never write over."""

from __future__ import annotations

from pathlib import Path

from modsim3d.campaign.results.folder import FILE, PLAN, VERDICTS, CampaignFolder


def files_of_campaign(folder: CampaignFolder) -> list[Path]:
    """Its plan and its rows."""
    rows = [folder.results.glob("scene=*/part-*.parquet"), folder.done.glob("[0-9]*.parquet")]
    named = [folder.path / name for name in (FILE, PLAN, VERDICTS)]
    return [*(path for path in named if path.is_file()), *(path for each in rows for path in sorted(each))]
