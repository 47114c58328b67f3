"""Intervals of means over few values: vessels, or seeds."""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.arrays import Array

_LEVEL = 0.95
_SAME = 1e-12
"""Values that differ by less than this share of their size are the same."""


def half_interval(values: Array) -> float | None:
    """Half of the 95 % interval of the mean of n values, by Student's t, shape (n,).

    None of fewer than two, if one is infinite, or if all are the same, which says nothing of how far others may be off.
    """
    count = len(values)
    if count < 2 or not np.isfinite(values).all():
        return None
    deviation = values.std(ddof=1)
    if deviation <= _SAME * max(1.0, abs(values.mean())):
        return None
    return float(special.stdtrit(count - 1, (1 + _LEVEL) / 2) * deviation / np.sqrt(count))
