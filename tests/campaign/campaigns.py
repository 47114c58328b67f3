"""Campaigns that tests write and run in this process."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.running import CampaignResult, run_plan
from modsim3d.campaign.work.checking import CheckedCampaign, checked
from modsim3d.campaign.workers import ThisProcess
from modsim3d.core.document import Block, Where, shown
from modsim3d.view.pages.page import html_of


def checked_campaign(folder: Path, name: str = "campaign.yaml", **keys: Any) -> CheckedCampaign:
    """A campaign with these keys, whose file is in the folder."""
    file = folder / name
    file.write_text(yaml.safe_dump(keys), encoding="utf-8")
    return checked(read_campaign(file))


def run_campaign_file(folder: Path, name: str = "campaign.yaml", **keys: Any) -> CampaignResult:
    """The same, run into the folder of the file's name."""
    result = run_plan(checked_campaign(folder, name, **keys), folder / Path(name).stem, ThisProcess)
    assert result is not None
    return result


def html_of_blocks(blocks: Iterable[Block]) -> str:
    """Blocks as a page shows them."""
    return "\n".join(map(html_of, shown(blocks, Where.PAGE)))
