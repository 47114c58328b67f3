"""Detections in the world: bearing, inverse range, and position where its error is nearly normal."""
