"""The pipeline from a scene to detections, its workers, and runs: into a directory and out of it."""
