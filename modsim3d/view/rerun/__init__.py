"""A run as a recording for the Rerun viewer."""
