"""How surely a box says whether it is around one of two overlapping vessels or around both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.boxes import errors_between, move, sizes
from modsim3d.learn.kinds.detection_shapes import Overlapping, Sought

_NEIGHBOURS = 60
_LONELY_NEEDED = 20
MOST_MISTAKEN = 0.04
"""Share of the boxes of one vessel alone that may look like one around both before they tell nothing."""
_LEAST_RECOGNIZED = 0.9


@dataclass(frozen=True, eq=False)
class Recognition:
    """How often boxes of p pairs look like one around both vessels.

    Attributes:
        mistaken: Of boxes of the larger and of the smaller vessel alone, shape (2, p).
        recognized: Of boxes around both, shape (p,).
    """

    mistaken: Array
    recognized: Array

    @property
    def unambiguous(self) -> Mask:
        """Pairs whose boxes tell whether they are around both, shape (p,)."""
        sure: Mask = (self.mistaken.max(axis=0) <= MOST_MISTAKEN) & (self.recognized >= _LEAST_RECOGNIZED)
        return sure

    @classmethod
    def of(cls, sought: Sought, pairs: Overlapping, whole: Mask) -> Recognition:
        """Find it from the errors of vessels that overlap none, are about as large and are not in two parts (n,).

        Where too few of those are known, all boxes of one vessel alone are mistaken and none around both is recognized.
        """
        lonely = sought.found & whole
        touching = Overlapping.of(sought, 1e-9)
        lonely[touching.larger] = lonely[touching.smaller] = False
        known = np.flatnonzero(lonely)
        count = min(_NEIGHBOURS, len(known))
        if len(known) < _LONELY_NEEDED or not len(pairs):
            return cls(np.ones((2, len(pairs))), np.zeros(len(pairs)))
        sides = np.tile(np.maximum(sizes(sought.boxes_px[known]), 1.0), 2)
        errors = errors_between(sought.match_px[known], sought.boxes_px[known]) / sides
        order = np.argsort(sides[:, :2].prod(axis=1), kind="stable")
        errors, area = errors[order], sides[order, :2].prod(axis=1)

        def share_that_fits(boxes_px: Array) -> Array:
            """Of boxes (p, 4) with such errors, the share that fits the box around the pair, shape (p,)."""
            ours = np.tile(np.maximum(sizes(boxes_px), 1.0), 2)
            middle = np.searchsorted(area, ours[:, :2].prod(axis=1))
            start = np.clip(middle - count // 2, 0, len(area) - count)
            near = errors[start[:, None] + np.arange(count)]
            drawn = move(boxes_px[:, None], near * ours[:, None])
            pair = np.broadcast_to(np.arange(len(pairs))[:, None], drawn.shape[:2])
            share: Array = pairs.fits(sought, pair, drawn)[0].mean(axis=1)
            return share

        mistaken = np.stack([share_that_fits(sought.boxes_px[each]) for each in (pairs.larger, pairs.smaller)])
        return cls(mistaken, share_that_fits(pairs.union_px))
