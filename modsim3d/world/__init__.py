"""What is where and how it moves: vessels and obstacles as solids, meshes, waves, inertial units."""
