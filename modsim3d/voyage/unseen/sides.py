"""The four sides of unmatched detections, and which of them are those of a whole thing.

A thing that comes into view grows from the image's border, and one behind a known vessel is seen in pieces. There only
the other sides tell where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.formats.labelled import Annotations
from modsim3d.formats.matching import image_pairs
from modsim3d.learn.observed.false_sightings import FalseSightings

AT_BORDER_PX = 5.0
"""A side so near to the image's border may be cut by it."""
_BESIDE, _NEAR_PX = 0.25, 5.0
"""A side so near to a known vessel's box may be hidden by it: beside it in heights of the box, and in pixels."""


@dataclass(frozen=True, eq=False)
class Sides:
    """Sides of n detections.

    Attributes:
        places_px: Left, upper, right and lower side, along and below the horizon, shape (n, 4).
        sure: Whether each is a side of the whole thing, as nothing cuts it off there, shape (n, 4).
        at_border: Whether the image's left or right border may cut it, shape (n,).
    """

    places_px: Array
    sure: Mask
    at_border: Mask

    @classmethod
    def of(cls, sightings: FalseSightings, known: Annotations, images: int) -> Sides:
        """Those of false detections beside known vessels, in so many images."""
        centre, half = np.column_stack([sightings.along_px, sightings.depth_px]), sightings.sizes_px / 2
        cut = _at_border(sightings)
        sure: Mask = ~(cut | _hidden(sightings, known, images))
        return cls(np.concatenate([centre - half, centre + half], axis=1), sure, cut[:, 0] | cut[:, 2])


def _at_border(sightings: FalseSightings) -> Mask:
    """Which sides lie at the border of their image, shape (n, 4)."""
    boxes = sightings.boxes_px
    with np.errstate(invalid="ignore"):
        near, far = boxes[:, :2] <= AT_BORDER_PX, boxes[:, 2:] >= sightings.image_px - AT_BORDER_PX
    cut: Mask = np.concatenate([near, far], axis=1)
    return cut


def _hidden(sightings: FalseSightings, known: Annotations, images: int) -> Mask:
    """Which sides lie in the box of a known vessel, or just beside it, shape (n, 4)."""
    hidden = np.zeros((len(sightings), 4), dtype=bool)
    for row, vessel in image_pairs(sightings.image, known.image, images):
        ours, theirs = sightings.boxes_px[row], known.boxes_px[vessel]
        beside_px = np.maximum(_BESIDE * (theirs[:, 3] - theirs[:, 1]), _NEAR_PX)
        near = np.column_stack([beside_px, np.full(len(row), _NEAR_PX)])
        low, high = theirs[:, :2] - near, theirs[:, 2:] + near
        meets = ((ours[:, :2] <= high) & (ours[:, 2:] >= low)).all(axis=1)
        inside = (ours >= np.tile(low, 2)) & (ours <= np.tile(high, 2))
        np.logical_or.at(hidden, row, inside & meets[:, None])
    return hidden
