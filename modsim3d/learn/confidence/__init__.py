"""Confidence: its distributions, slopes and persistence."""
