"""How well a number is known, and how entries of a detector file are named and written."""
