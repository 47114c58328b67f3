"""A detector learned from a voyage: its detections against the truth that AIS and the camera's pose give."""
