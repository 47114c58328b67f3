"""Learning: a detector file out of a detector's results on a labelled set."""
