"""Tracks in the images of a run and in the world: files in and out, and which vessel each follows in the images."""
