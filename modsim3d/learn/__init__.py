"""What a detector's output says about the detector: a detector file out of it, and whether a run obeys one."""
