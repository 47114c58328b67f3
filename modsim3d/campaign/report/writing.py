"""Writes the page that a campaign has: that of its plan, or that of its search."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from modsim3d.campaign.report.campaign_page import write_campaign_page
from modsim3d.campaign.report.search_page import write_search_page
from modsim3d.campaign.results.folder import CampaignFolder


def write_page(
    folder: CampaignFolder,
    path: Path,
    advance: Callable[[int], None] = lambda done: None,
    command: str | None = None,
) -> str:
    """Write the page of a campaign, and return its first sentence.

    Args:
        folder: The campaign, finished or not.
        path: The file.
        advance: Called with 1 after each picture.
        command: What the page says it was made by; the call from Python if None.

    Raises:
        ModsimError: The results are damaged, or the page cannot be written.
    """
    if folder.keys.search is not None:
        return write_search_page(folder, path, command)
    return write_campaign_page(folder, path, advance, command)
