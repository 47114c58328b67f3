"""From a campaign file to numbered runs: conditions, drawn parameters and seeds."""
