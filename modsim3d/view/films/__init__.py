"""Films and single pictures of a stored run."""
