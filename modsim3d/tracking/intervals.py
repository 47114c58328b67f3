"""Intervals of means over few values: vessels, or seeds."""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.arrays import Array

_LEVEL = 0.95


def half_interval(values: Array) -> float | None:
    """Half of the 95 % interval of the mean of n values, by Student's t; None of fewer than two, shape (n,)."""
    count = len(values)
    if count < 2:
        return None
    return float(special.stdtrit(count - 1, (1 + _LEVEL) / 2) * values.std(ddof=1) / np.sqrt(count))
