"""A search for the scenes and seeds in which a tracker fails: evidence of failure, and never part of a rate."""
