"""Checks: does a run obey its detector file, and do the sources of truth agree."""
