"""Pictures, films, maps and pages of runs, for people."""
