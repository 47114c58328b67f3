"""Files of a run, written and read back, and files of other programs."""
