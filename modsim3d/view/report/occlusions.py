"""When an occlusion of a vessel begins and ends, from its visible fractions, so that a flicker is none."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Indices, Mask

BEGINS, ENDS = 225, 245
"""In 250ths: an occlusion begins where a vessel's visible fraction is at most 0.9 and lasts until it is above 0.98."""


class Occlusions:
    """Which rows of one camera are part of an occlusion, for rows that come in parts."""

    def __init__(self, vessels: int) -> None:
        """Begin with none of so many vessels."""
        self._last = np.full(vessels, -2)
        self._occluded = np.zeros(vessels, dtype=bool)

    def of(self, index: Indices, vessel: Indices, fraction: Indices) -> Mask:
        """Whether each vessel is occluded, shape (n,).

        Args:
            index: Index of the step of each row, after those of the parts before, shape (n,). A vessel has at most
                one row for each step; a step without one ends its occlusion.
            vessel: Its vessel, shape (n,).
            fraction: Its visible fraction in 250ths, shape (n,).
        """
        if not len(index):
            return np.zeros(0, dtype=bool)
        order = np.lexsort((index, vessel))
        step, whose, seen = index[order], vessel[order], fraction[order]
        first = np.append(True, np.diff(whose) != 0)
        goes_on = np.where(first, step - self._last[whose] == 1, np.diff(step, prepend=step[0]) == 1)
        before = first & goes_on & self._occluded[whose]
        between = (seen > BEGINS) & (seen <= ENDS)
        known = np.where(between, before, seen <= BEGINS)
        # Between the two limits it is as it was in the row before.
        source = np.maximum.accumulate(np.where(between & goes_on & ~first, 0, np.arange(len(step))))
        occluded = known[source]
        last = np.append(first[1:], True)
        self._last[whose[last]], self._occluded[whose[last]] = step[last], occluded[last]
        result = np.empty(len(index), dtype=bool)
        result[order] = occluded
        return result
