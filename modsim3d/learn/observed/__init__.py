"""What the estimators look at: annotations and detections, matched, state by state."""
