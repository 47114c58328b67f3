"""Chooses frames of a run that are worth looking at."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from modsim3d.arrays import Array, Mask
from modsim3d.runs.files.columns import flags, numbers
from modsim3d.runs.files.tables import BOX_SIDES


@dataclass(frozen=True)
class Highlight:
    """A frame of a run and what to look at in it.

    Attributes:
        step: Step of the frame.
        camera: ID of the camera that took it.
        focus_px: The box to look at: x_min, y_min, x_max, y_max, in pixels.
        caption: What happens in the box.
    """

    step: int
    camera: str
    focus_px: tuple[float, float, float, float]
    caption: str


@dataclass(frozen=True, eq=False)
class _Rows:
    """Columns of a part of `truth.parquet`; a fraction that is not known counts as one."""

    fraction: Array
    silhouette_px: Array
    visible_px: Array
    occluded: Mask
    annotated: Mask
    detected: Mask

    @classmethod
    def of(cls, table: pa.Table) -> _Rows:
        fraction = numbers(table, "visible_fraction")
        return cls(
            np.where(np.isnan(fraction), 1.0, fraction),
            numbers(table, "silhouette_px"),
            numbers(table, "visible_px"),
            pc.list_value_length(table["occluded_by"]).to_numpy() > 0,
            flags(table, "annotated"),
            flags(table, "detected"),
        )

    @property
    def hidden_in_part(self) -> Mask:
        return self.occluded & (self.fraction > 0) & (self.fraction < 1) & self.annotated

    @property
    def clear(self) -> Mask:
        clear: Mask = (self.fraction == 1) & self.annotated
        return clear


@dataclass(frozen=True)
class _Kind:
    """A kind of highlight: which rows it may be, their rank (the least is shown), and the caption of a row."""

    wanted: Callable[[_Rows], Mask]
    rank: Callable[[_Rows], Array]
    caption: Callable[[dict[str, Any]], str]


def _hider(row: dict[str, Any]) -> str:
    hider = max(row["occluded_by"], key=lambda entry: entry["px"])["id"]
    if row["visible_fraction"] == 0:
        return f"wholly hidden by {hider}"
    hidden = min(1 - row["visible_fraction"], 0.99)  # something is seen: "100 %" would be another thing
    return f"{hidden:.0%} hidden by {hider}, {'detected' if row['detected'] else 'missed'}"


KINDS = (
    _Kind(lambda r: r.hidden_in_part & r.detected, lambda r: np.abs(r.fraction - 0.5), _hider),
    _Kind(lambda r: r.hidden_in_part & ~r.detected, lambda r: r.fraction, _hider),
    _Kind(lambda r: (r.visible_px == 0) & r.occluded, lambda r: -r.silhouette_px, _hider),
    _Kind(lambda r: r.clear & r.detected, lambda r: -r.silhouette_px, lambda row: "detected"),
    _Kind(lambda r: r.clear & ~r.detected, lambda r: -r.silhouette_px, lambda row: "missed, though in plain view"),
)


def pick_highlights(folder: Path) -> list[Highlight]:
    """One highlight of each kind that the run has: occlusion, recovery from it, a miss, a false alarm, and so on.

    Args:
        folder: A finished run directory.
    """
    best: list[tuple[float, dict[str, Any]] | None] = [None] * len(KINDS)
    for table in _parts(folder / "truth.parquet"):
        rows = _Rows.of(table)
        for k, kind in enumerate(KINDS):
            best[k] = _better(best[k], table, np.where(kind.wanted(rows), kind.rank(rows), np.inf))
    found = [
        Highlight(
            row["step"], row["camera"], tuple(row[f"full_{side}"] for side in BOX_SIDES), f"{row['vessel']}: {caption}"
        )
        for row, caption in (
            (entry[1], kind.caption(entry[1])) for entry, kind in zip(best, KINDS, strict=True) if entry
        )
    ]
    false: tuple[float, dict[str, Any]] | None = None
    for table in _parts(folder / "detections.parquet"):
        size = table["width_px"].to_numpy() * table["height_px"].to_numpy()
        false = _better(false, table, np.where(table["vessel"].is_null().to_numpy(), -size, np.inf))
    return found if false is None else [*found, _false_alarm(false[1])]


def _parts(path: Path) -> Iterator[pa.Table]:
    """A table row group by row group: a long run's is larger than memory."""
    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            yield file.read_row_group(group)


def _better(
    best: tuple[float, dict[str, Any]] | None, table: pa.Table, rank: Array
) -> tuple[float, dict[str, Any]] | None:
    """The row that ranks least, of the best so far and a part of a table; infinite where a row is not wanted."""
    least = float(rank.min(initial=np.inf))
    if least >= (best[0] if best else np.inf):
        return best
    row = int(np.argmin(rank))
    return least, table.slice(row, 1).to_pylist()[0]


def _false_alarm(row: dict[str, Any]) -> Highlight:
    """The largest false positive."""
    x, y, half = row["x_px"], row["y_px"], (row["width_px"] / 2, row["height_px"] / 2)
    return Highlight(
        row["step"], row["camera"], (x - half[0], y - half[1], x + half[0], y + half[1]), "a false positive"
    )
