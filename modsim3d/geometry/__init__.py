"""The mathematics of places and views: rotations, cameras, lenses, clipping, the curved sea, kinematics."""
