"""The mathematics of views: rotations, cameras, lenses, clipping, the curved sea, rates from poses."""
