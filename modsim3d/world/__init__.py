"""Vessels and obstacles as solids, and how they move: poses, traffic, waves, inertial units."""
