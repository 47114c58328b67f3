"""Vessels and obstacles as solids, how they move, meshes, waves, inertial units."""
