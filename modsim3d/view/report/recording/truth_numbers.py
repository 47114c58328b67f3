"""The numbers of the truth that only the table below the picture shows: pixels counted, and who hides how many."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.runs.run_rows import RunRows
from modsim3d.view.report.recording.packing import NONE, ROW_BEFORE, Coded, Column, starts

WHOLE_SILHOUETTE = NONE - 1
"""Fractions of a silhouette that are in the image are counted in 65,534ths; `NONE` is a null."""


def number_columns(rows: RunRows, shown: Indices, main_hider: Indices) -> dict[str, Column | Coded]:
    """Columns of some rows of the truth.

    What can be computed from other columns is left out. Pixels that are hidden are stored in place of those that are
    seen, as most are 0; the pixels that the main hider hides are those that the others do not.

    Args:
        rows: All rows of the run.
        shown: Indices of the rows, shape (k,).
        main_hider: For each row of the run, the occluder that hides most of it, shape (n,).

    Returns:
        `silhouettePx`, `hiddenPx` and `inFrame`, shape (k,); `otherName` and `otherPx`: the occluders of each row
        other than the main one, most pixels first; `otherStart`: where those of each row begin, shape (k + 1,).
    """
    silhouette_px = rows.numbers("silhouette_px")[shown]
    occluders = rows.occluders()
    place = np.full(len(rows.truth_frame), -1)
    place[shown] = np.arange(len(shown))
    of = np.where(occluders.name == main_hider[occluders.hidden], -1, place[occluders.hidden])
    order = np.lexsort((-occluders.px, of))
    order = order[of[order] >= 0]
    return {
        "silhouettePx": silhouette_px.astype(np.float32),
        "hiddenPx": (silhouette_px - rows.numbers("visible_px")[shown]).astype(np.float32),
        "inFrame": _in_parts(rows.numbers("in_frame_fraction")[shown]),
        "otherStart": Coded(starts(of[order], len(shown)), by=ROW_BEFORE),
        "otherName": occluders.name[order].astype(np.uint16),
        "otherPx": occluders.px[order].astype(np.float32),
    }


def _in_parts(fraction: Array) -> Column:
    """Fractions in `WHOLE_SILHOUETTE`ths, of the same shape; a part never becomes 0 or all."""
    counted = np.rint(np.nan_to_num(fraction) * WHOLE_SILHOUETTE)
    counted = np.clip(counted, fraction > 0, WHOLE_SILHOUETTE - (fraction < 1))
    return np.where(np.isnan(fraction), NONE, counted).astype(np.uint16)
