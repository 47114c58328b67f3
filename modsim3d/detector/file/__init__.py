"""Detector files: their keys, what must hold between them, reading and writing."""
