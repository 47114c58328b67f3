"""Scores of tracks on the sea, in metres, and of encounters with own ship."""
