"""Poses from real traffic: AIS reports in, a scene folder out."""
