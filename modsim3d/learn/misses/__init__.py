"""Misses and confusions, and what they follow."""
