"""Moved to `modsim3d.runs.stored_run`."""

from modsim3d.runs.stored_run import StoredRun, open_run

__all__ = ["StoredRun", "open_run"]
