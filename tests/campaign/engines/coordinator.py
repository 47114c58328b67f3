"""Runs a campaign as the command line would, in a process that tests may kill."""

from __future__ import annotations

import sys
from pathlib import Path

from modsim3d.campaign.engines.dask_engine import DaskEngine
from modsim3d.campaign.engines.pool import ProcessPool
from modsim3d.campaign.file.reading import read_campaign
from modsim3d.campaign.running import run_plan
from modsim3d.campaign.work.checking import checked

if __name__ == "__main__":
    engine, file, out = sys.argv[1:]
    run_plan(
        checked(read_campaign(file)),
        Path(out),
        lambda: ProcessPool(int(engine)) if engine.isdigit() else DaskEngine(engine),
    )
