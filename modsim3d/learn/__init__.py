"""A detector file out of a detector's results."""
