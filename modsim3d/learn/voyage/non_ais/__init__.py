"""Detections that match no known vessel: of vessels without a transponder, or false."""
