"""Trackers behind a run, and their scores."""
