"""What a camera may have in front of it: vessels' dimensions and solids, shapes by name and from files, obstacles."""
