"""Whether a run obeys its detector file, and whether the sources of truth agree."""
