"""Pictures, films, maps and pages for people to look at."""
