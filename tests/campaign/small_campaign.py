"""A finished campaign of one run."""

from __future__ import annotations

import shutil
import tempfile
from functools import lru_cache
from pathlib import Path

from tests.campaign.campaigns import run_campaign_file


def small_campaign(parent: Path) -> Path:
    """A folder `campaign` with it, made if it is not there."""
    folder = parent / "campaign"
    if not folder.exists():
        shutil.copytree(_made(), folder)
    return folder


@lru_cache(maxsize=1)
def _made() -> Path:
    result = run_campaign_file(Path(tempfile.mkdtemp()), scene="harbour", steps=20, trackers=["reference"])
    return result.folder.path
