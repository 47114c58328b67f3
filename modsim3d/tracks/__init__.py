"""Tracks of a tracker in the images of a run: files, and which vessel each follows."""
