"""Scores of tracks as a sentence, tables, `score.json` and a page."""
