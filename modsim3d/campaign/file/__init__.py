"""The campaign file: its keys, and reading it."""
