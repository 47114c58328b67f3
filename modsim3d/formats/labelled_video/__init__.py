"""A detector over the truth of somebody's labelled video."""
