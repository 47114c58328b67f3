"""Which boxes and covariances a track may have: one rule for what a tracker answers and for what a file holds."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

FAR = "the box lies more than an image away from the image, as does all of its track"


def far_tracks(boxes_px: Array, track: Indices, image_px: Array) -> Mask:
    """Which boxes (k, 4) are of a track that never comes within an image of its image, shape (k,).

    A track that has been there may coast as far as it likes: its boxes are false positives.

    Args:
        boxes_px: The boxes.
        track: What tells the track of each from others, shape (k,) or (k, columns).
        image_px: Width and height of the image, or of each box's, shape (2,) or (k, 2).
    """
    beyond: Mask = (boxes_px[:, 2:] < -image_px) | (boxes_px[:, :2] > 2 * image_px)
    far: Mask = np.any(beyond, axis=1)
    if far.any():
        _, own = np.unique(track, axis=0, return_inverse=True)
        near = np.bincount(own.reshape(-1), weights=~far) > 0
        return far & ~near[own.reshape(-1)]
    return far


def covariances(xx: Array, xy: Array, yy: Array) -> Mask:
    """Whether variances and a covariance are those of a distribution, same shape; not where any is NaN."""
    possible: Mask = (xx > 0) & (yy > 0) & (xx * yy > xy * xy) & np.isfinite(xx + yy)
    return possible
