"""A finished campaign of one run."""

from __future__ import annotations

import shutil
import tempfile
from functools import lru_cache
from pathlib import Path

from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.running import run_plan
from modsim3d.campaign.work.checking import checked
from modsim3d.campaign.workers import ThisProcess

TEXT = """\
scene: harbour
steps: 20
trackers: [reference]
"""


def small_campaign(parent: Path) -> Path:
    """A folder `campaign` with it, made if it is not there."""
    folder = parent / "campaign"
    if not folder.exists():
        shutil.copytree(_made(), folder)
    return folder


@lru_cache(maxsize=1)
def _made() -> Path:
    folder = Path(tempfile.mkdtemp())
    file = folder / "small.yaml"
    file.write_text(TEXT)
    run_plan(checked(read_campaign(file)), folder / "campaign", ThisProcess)
    return folder / "campaign"
