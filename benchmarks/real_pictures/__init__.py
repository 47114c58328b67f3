"""Comparison of simulated with real detections on real pictures."""
