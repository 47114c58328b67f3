"""Whether the files of a campaign are still as they were when it was planned."""

from __future__ import annotations

from modsim3d.campaign.results.folder import CampaignFolder
from modsim3d.campaign.work.task import changes
from modsim3d.errors import InputError


def check_files(folder: CampaignFolder) -> None:
    """Refuse to make runs of a campaign again from files that are not the same.

    Raises:
        InputError: With every file that has changed or is not there.
    """
    if problems := changes(folder.work):
        hint = "put the files back as they were: runs are made again from the same bytes only"
        raise InputError(f"campaign {folder.path}", [*problems, hint])
