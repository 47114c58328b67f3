"""Rotations, cameras, lenses, clipping, the curved sea and rates from poses: mathematics on arrays."""
