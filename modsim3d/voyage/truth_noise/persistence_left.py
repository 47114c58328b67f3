"""How long the detector's errors persist, once errors of truth, which last far longer, are taken off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.arrays import Array
from modsim3d.learn.numbers.entries import Entry

_LEAST = 0.01
"""Correlation from one frame to the next that a replicate keeps: frames do not tell less from none."""


def share_left(entry: Entry, part: Array) -> Entry:
    """The share of errors that vessels keep, less a part (rows,) of all errors that is kept for ever."""
    left = np.maximum((entry.column.values - part) / (1 - part), 0)
    return replace(entry, column=replace(entry.column, values=left))


def time_left(entry: Entry, part: Array, gap_s: float) -> Entry:
    """The correlation time of errors, less a part (rows,) of all errors that is kept for ever.

    It was learned from frames that follow each other, so their correlation is what must come out.
    """
    correlation = np.exp(-gap_s / np.maximum(entry.column.values, 1e-9))
    left = np.clip((correlation - part) / (1 - part), 0, 1)
    left[1:] = np.maximum(left[1:], _LEAST)
    time_s = np.where(left > 0, gap_s / -np.log(np.clip(left, 1e-12, 1 - 1e-12)), 0.0)
    return replace(entry, column=replace(entry.column, values=np.where(part > 0, time_s, entry.column.values)))
