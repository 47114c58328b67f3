"""Scores of tracks in the world, in metres, and of encounters with own ship."""
