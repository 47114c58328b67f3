"""Scores of tracks against what was true."""
