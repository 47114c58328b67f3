"""Frames of a run that are worth looking at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array
from modsim3d.runs.files.columns import flags, numbers
from modsim3d.runs.files.stored_tables import StoredTable, StoredTables
from modsim3d.runs.files.tables import BOX_SIDES
from modsim3d.view.pictures.window import Box


@dataclass(frozen=True)
class Highlight:
    """A frame of a run, the box to look at in it, and what happens there."""

    step: int
    camera: str
    focus_px: Box
    caption: str


def pick_highlights(tables: StoredTables) -> list[Highlight]:
    """One highlight of each kind that a finished run has: occlusion, recovery from it, a miss, a false alarm, ..."""
    truth = _least(tables.by_name["truth"], len(CAPTIONS), _truth_ranks)
    (false,) = _least(tables.by_name["detections"], 1, _false_alarm_ranks)
    found = [
        Highlight(
            row["step"],
            row["camera"],
            tuple(row[f"full_{side}"] for side in BOX_SIDES),
            f"{row['vessel']}: {caption or _hidden_by(row)}",
        )
        for row, caption in zip(truth, CAPTIONS, strict=True)
        if row
    ]
    return found if false is None else [*found, _false_alarm(false)]


CAPTIONS = (None, None, None, "detected", "missed, though in plain view")
"""What happens in each kind of highlight of the truth; None: who hides the vessel."""


def _truth_ranks(truth: pa.Table) -> list[Array]:
    """For each kind of highlight the rank of each row, shape (n,): the least is shown, an infinite one never."""
    fraction = np.nan_to_num(numbers(truth, "visible_fraction"), nan=1.0)
    silhouette_px, visible_px = numbers(truth, "silhouette_px"), numbers(truth, "visible_px")
    occluded = pc.list_value_length(truth["occluded_by"]).to_numpy() > 0
    annotated, detected = flags(truth, "annotated"), flags(truth, "detected")
    partly_hidden = occluded & (fraction > 0) & (fraction < 1) & annotated
    clear = (fraction == 1) & annotated
    kinds = (
        (partly_hidden & detected, np.abs(fraction - 0.5)),
        (partly_hidden & ~detected, fraction),
        ((visible_px == 0) & occluded, -silhouette_px),
        (clear & detected, -silhouette_px),
        (clear & ~detected, -silhouette_px),
    )
    return [np.where(wanted, rank, np.inf) for wanted, rank in kinds]


def _false_alarm_ranks(detections: pa.Table) -> list[Array]:
    """The largest false positive first."""
    size = detections["width_px"].to_numpy() * detections["height_px"].to_numpy()
    return [np.where(detections["vessel"].is_null().to_numpy(), -size, np.inf)]


def _least(stored: StoredTable, kinds: int, ranks_of: Callable[[pa.Table], list[Array]]) -> list[dict[str, Any] | None]:
    """For each kind the row of a table that ranks least, None if no row is of the kind."""
    least = [np.inf] * kinds
    rows: list[dict[str, Any] | None] = [None] * kinds
    for table in stored.groups():
        for kind, rank in enumerate(ranks_of(table)):
            if rank.min(initial=np.inf) < least[kind]:
                least[kind] = float(rank.min())
                rows[kind] = table.slice(int(np.argmin(rank)), 1).to_pylist()[0]
    return rows


def _hidden_by(row: dict[str, Any]) -> str:
    hider = max(row["occluded_by"], key=lambda entry: entry["px"])["id"]
    if row["visible_fraction"] == 0:
        return f"wholly hidden by {hider}"
    hidden = min(1 - row["visible_fraction"], 0.99)  # something is seen: "100 %" would be another thing
    return f"{hidden:.0%} hidden by {hider}, {'detected' if row['detected'] else 'missed'}"


def _false_alarm(row: dict[str, Any]) -> Highlight:
    return Highlight(row["step"], row["camera"], tuple(row[side] for side in BOX_SIDES), "a false positive")
