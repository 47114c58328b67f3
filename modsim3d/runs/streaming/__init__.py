"""Detections line by line, while a scene is simulated."""
