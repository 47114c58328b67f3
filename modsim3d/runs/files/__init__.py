"""The files of a run directory: tables, JSON, kept truth; written and read."""
