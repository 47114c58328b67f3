"""A run: the pipeline from a scene to truth and detections, its blocks and frames, and its directory on the disk."""
