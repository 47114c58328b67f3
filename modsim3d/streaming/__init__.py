"""Detections as a scene is simulated: one line of JSON for each camera and step, for trackers that read along."""
