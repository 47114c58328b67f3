"""A detector file from a voyage without labels: AIS and own ship's log are the truth."""
