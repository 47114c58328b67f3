"""Detectors that a campaign makes: another miss rate, and parameters drawn from what `learn` is not sure of."""
