"""Runs a campaign as the command line would, in a process that tests may kill."""

import sys

from modsim3d import run_campaign

if __name__ == "__main__":
    engine, file, out = sys.argv[1:]
    run_campaign(file, out, **({"workers": int(engine)} if engine.isdigit() else {"scheduler": engine}))
