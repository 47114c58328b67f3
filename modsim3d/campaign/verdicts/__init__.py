"""Requirements: met, failed or undecided, with intervals over traffic seeds."""
