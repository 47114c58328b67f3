"""Counts of two runs of the same truth side by side, as rows of tables."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Mask
from modsim3d.runs.run_rows import RunRows
from modsim3d.view.report.count_tables import CountTables, Rows

PAIRED_HEADER = ("Vessel", "Annotated", "Detected by both", "Only by A", "Only by B", "By neither")


def compared_counts(first: CountTables, second: CountTables) -> Rows:
    """Name of each count of `DetectorCounts.named`, the count and its share in the first and in the second run."""
    pairs = zip(first.total.named(), second.total.named(), strict=True)
    return [(name, one, share, other, second_share) for (name, one, share), (_, other, second_share) in pairs]


def paired_detections(first: RunRows, second: RunRows) -> Rows:
    """How many annotated vessels both, one or none of the runs detected, by vessel and in all; see `PAIRED_HEADER`."""
    vessel, given = first.truth_vessel, first.annotated
    rows = [_paired(name, first, second, given & (vessel == i)) for i, name in enumerate(first.scene.vessel_names)]
    return [*rows, _paired("all", first, second, given)]


def _paired(name: str, first: RunRows, second: RunRows, given: Mask) -> tuple[str, ...]:
    one, other = first.detected[given], second.detected[given]
    counts = (len(one), *(int(np.sum(each)) for each in (one & other, one & ~other, ~one & other, ~one & ~other)))
    return name, *map(str, counts)
