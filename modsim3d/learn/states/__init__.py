"""Performance states: which conditions each has, and how they follow each other."""
