"""Runs a campaign as the command line would, in a process that tests may kill."""

from __future__ import annotations

import sys
from pathlib import Path

from modsim3d.campaign.dask import DaskEngine
from modsim3d.campaign.keys import read_campaign
from modsim3d.campaign.running import run_plan
from modsim3d.campaign.work.checking import checked
from modsim3d.campaign.workers import ProcessPool

if __name__ == "__main__":
    engine, file, out = sys.argv[1:]
    run_plan(
        checked(read_campaign(file)),
        Path(out),
        lambda: ProcessPool(int(engine)) if engine.isdigit() else DaskEngine(engine),
    )
