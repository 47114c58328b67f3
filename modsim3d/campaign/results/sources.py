"""Whether the files of a campaign are still as they were when it was planned."""

from __future__ import annotations

from pathlib import Path

from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.work.files import changed_files
from modsim3d.errors import InputError


def check_files(folder: CampaignFolder) -> None:
    """Refuse to make runs of a campaign again from files that are not the same.

    Raises:
        InputError: With every file that has changed or is not there.
    """
    problems = changed_files(folder.facts["files"], Path(folder.facts["base"]))
    if problems:
        hint = "put the files back as they were: runs are made again from the same bytes only"
        raise InputError(f"campaign {folder.path}", [*problems, hint])
