"""A finished campaign of one run."""

import shutil
import tempfile
from functools import lru_cache
from pathlib import Path

from tests.campaign.campaigns import run_campaign_file


def small_campaign(parent: Path) -> Path:
    """A folder `campaign` with it, made if it is not there."""
    folder = parent / "campaign"
    return folder if folder.exists() else shutil.copytree(_made(), folder)


@lru_cache(maxsize=1)
def _made() -> Path:
    keys = {"scene": "harbour", "steps": 20, "trackers": ["reference"]}
    return run_campaign_file(Path(tempfile.mkdtemp()), **keys).folder.path
