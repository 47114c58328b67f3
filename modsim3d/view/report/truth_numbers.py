"""The numbers of the truth that only the table below the picture shows: pixels counted, and who hides how many."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.runs.run_rows import RunRows
from modsim3d.view.report.packing import NONE, ROW_BEFORE, Coded, Column, starts

WHOLE_IMAGE = NONE - 1
"""Fractions of a silhouette that are in the image are counted in 65,534ths; `NONE` is a null."""


def number_columns(rows: RunRows, shown: Indices) -> dict[str, Column | Coded]:
    """Columns of some rows of the truth, by their indices.

    Pixels that are hidden are stored in place of those that are seen: most are 0. `hiderName` and `hiderPx` have the
    entries of each row from `hiderStart` on, most pixels first.
    """
    silhouette_px = rows.numbers("silhouette_px")[shown]
    occluders = rows.occluders()
    place = np.full(len(rows.truth_frame), -1)
    place[shown] = np.arange(len(shown))
    hidden = place[occluders.hidden]
    order = np.lexsort((-occluders.px, hidden))
    order = order[hidden[order] >= 0]
    return {
        "silhouettePx": silhouette_px.astype(np.float32),
        "hiddenPx": (silhouette_px - rows.numbers("visible_px")[shown]).astype(np.float32),
        "inFrame": _in_parts(rows.numbers("in_frame_fraction")[shown]),
        "hiderStart": Coded(starts(hidden[order], len(shown)), by=ROW_BEFORE),
        "hiderName": occluders.name[order].astype(np.uint16),
        "hiderPx": occluders.px[order].astype(np.float32),
    }


def _in_parts(fraction: Array) -> Column:
    """Fractions in `WHOLE_IMAGE`ths, of the same shape; a part never becomes 0 or all."""
    counted = np.clip(np.rint(np.nan_to_num(fraction) * WHOLE_IMAGE), fraction > 0, WHOLE_IMAGE - (fraction < 1))
    return np.where(np.isnan(fraction), NONE, counted).astype(np.uint16)
