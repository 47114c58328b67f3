"""Frames of a run that are worth looking at."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.arrays import Array
from modsim3d.boxes import areas, unions
from modsim3d.runs.files.columns import flags, numbers
from modsim3d.runs.files.stored_tables import StoredTables
from modsim3d.runs.files.table_columns import BOX_SIDES
from modsim3d.runs.outcomes import Outcome, having
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.vessels.obstacles import PREFIX
from modsim3d.view.pictures.window import Box

Rows = TypeVar("Rows")


@dataclass(frozen=True)
class Highlight:
    """A frame of a run, the box to look at in it, the vessel if it is about one, and what happens there."""

    step: int
    camera: str
    focus_px: Box
    vessel: str | None
    what: str = ""


def pick_highlights(tables: StoredTables, scene: Scene) -> list[Highlight]:
    """One highlight of each kind that a finished run has: occlusion, a miss, a wrong class, a bad box, ..."""
    of_truth = _least(tables.by_name["truth"].groups(), _truth_ranks, _of_truth)
    return of_truth + _least(_detection_groups(tables, scene), _detection_ranks, _of_detection)


def _truth_ranks(truth: pa.Table) -> list[Array]:
    """For each kind of highlight the rank of each row, shape (n,): the least is shown, an infinite one never."""
    fraction = np.nan_to_num(numbers(truth, "visible_fraction"), nan=1.0)
    silhouette_px, visible_px = numbers(truth, "silhouette_px"), numbers(truth, "visible_px")
    occluded = pc.list_value_length(truth["occluded_by"]).to_numpy() > 0
    annotated, detected = flags(truth, "annotated"), flags(truth, "detected")
    partly_hidden = occluded & (fraction > 0) & (fraction < 1) & annotated
    kinds = (
        (partly_hidden & detected, np.abs(fraction - 0.5)),
        (partly_hidden & ~detected, fraction),
        ((visible_px == 0) & occluded, -silhouette_px),
        ((fraction == 1) & annotated & ~detected, -silhouette_px),
    )
    return [np.where(wanted, rank, np.inf) for wanted, rank in kinds]


def _of_truth(truth: pa.Table, index: int) -> Highlight:
    row = truth.slice(index, 1).to_pylist()[0]
    box = tuple(row[f"full_{side}"] for side in BOX_SIDES)
    what = _hidden_by(row) if row["occluded_by"] else "in plain view"
    return Highlight(row["step"], row["camera"], box, row["vessel"], what)


def _hidden_by(row: dict[str, Any]) -> str:
    hider = max(row["occluded_by"], key=lambda entry: entry["px"])["id"].removeprefix(PREFIX)
    if row["visible_fraction"] == 0:
        return f"wholly hidden by {hider}"
    hidden = min(1 - row["visible_fraction"], 0.99)  # something is seen: "100 %" would be another thing
    return f"{100 * hidden:.0f} % hidden by {hider}"


def _detection_groups(tables: StoredTables, scene: Scene) -> Iterable[RunRows]:
    """The detections, row group by row group, with the truth of their steps."""
    for detections in tables.by_name["detections"].groups():
        if not len(detections):
            continue
        first, stop = detections["step"][0].as_py(), detections["step"][-1].as_py() + 1
        others = {name: tables.by_name[name].rows(first, stop).table for name in ("frames", "truth")}
        yield RunRows.of_tables(scene, scene.steps, {**others, "detections": detections})


def _detection_ranks(rows: RunRows) -> list[Array]:
    """As `_truth_ranks`: the largest one of each kind."""
    size, outcome = areas(rows.detection_boxes_px()), rows.outcomes
    has = {flag: having(outcome, flag) for flag in Outcome}
    known = ~has[Outcome.FALSE_POSITIVE]
    vessel_size = np.zeros(len(size))
    vessel_size[known] = areas(rows.annotated_boxes_px[rows.detected_row[known]])
    kinds = (
        (outcome == 0, vessel_size),
        (has[Outcome.MISLABELLED], vessel_size),
        (has[Outcome.BELOW_HALF_IOU] & ~has[Outcome.OFF_VESSEL], vessel_size),
        (has[Outcome.OFF_VESSEL], vessel_size),
        (has[Outcome.FALSE_POSITIVE], size),
    )
    return [np.where(wanted, -most, np.inf) for wanted, most in kinds]


def _of_detection(rows: RunRows, index: int) -> Highlight:
    row = rows.detections.slice(index, 1).to_pylist()[0]
    box, vessel, what = rows.detection_boxes_px()[index : index + 1], row["vessel"], ""
    if rows.outcomes[index] & Outcome.FALSE_POSITIVE:
        double = f", {row['kind']} of {vessel}" if vessel else ""
        what = f"a false alarm{double}: {row['label']} {row['confidence']:.2f}"
        vessel = None
    else:
        box = unions(box, rows.annotated_boxes_px[rows.detected_row[index : index + 1]])
    x0, y0, x1, y1 = box[0].tolist()
    return Highlight(row["step"], row["camera"], (x0, y0, x1, y1), vessel, what)


def _least(
    groups: Iterable[Rows], ranks_of: Callable[[Rows], list[Array]], highlight_of: Callable[[Rows, int], Highlight]
) -> list[Highlight]:
    """For each kind that there is, the highlight of the row that ranks least."""
    found: dict[int, tuple[float, Highlight]] = {}
    for rows in groups:
        for kind, rank in enumerate(ranks_of(rows)):
            least = float(rank.min(initial=np.inf))
            if least < (found[kind][0] if kind in found else np.inf):
                found[kind] = least, highlight_of(rows, int(np.argmin(rank)))
    return [found[kind][1] for kind in sorted(found)]
