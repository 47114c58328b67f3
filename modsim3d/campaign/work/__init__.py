"""Work of one worker: truth, detections, tracks and scores of some runs, as rows of a table."""
