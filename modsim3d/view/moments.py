"""Which frames of a run are worth a look."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq


@dataclass(frozen=True)
class Moment:
    """A frame of a run and what to look at in it.

    Attributes:
        step: Of the frame.
        camera: Its ID.
        focus_px: Box to look at: x_min, y_min, x_max, y_max.
        caption: What happens there.
    """

    step: int
    camera: str
    focus_px: tuple[float, float, float, float]
    caption: str


def pick_moments(folder: Path) -> list[Moment]:
    """One moment of each kind that the run has: occlusion, recovery from it, a miss, a false alarm, and so on.

    Args:
        folder: A finished run directory.
    """
    truth = pq.read_table(folder / "truth.parquet").to_pylist()
    detections = pq.read_table(folder / "detections.parquet").to_pylist()
    candidates = [
        _best(
            truth,
            lambda r: _hidden(r) and r["annotated"] and r["detected"],
            lambda r: abs(_fraction(r) - 0.5),
            _hider,
        ),
        _best(truth, lambda r: _hidden(r) and r["annotated"] and not r["detected"], _fraction, _hider),
        _best(
            truth,
            lambda r: r["visible_px"] == 0 and r["occluded_by"],
            lambda r: -r["silhouette_px"],
            _hider,
        ),
        _best(truth, lambda r: _clear(r) and r["detected"], lambda r: -r["silhouette_px"], lambda r: "detected"),
        _best(
            truth,
            lambda r: _clear(r) and not r["detected"],
            lambda r: -r["silhouette_px"],
            lambda r: "missed, though in plain view",
        ),
        _false_alarm(truth, detections),
    ]
    return [moment for moment in candidates if moment is not None]


def _best(rows: list[dict[str, Any]], wanted: Any, rank: Any, say: Any) -> Moment | None:
    """The row that is wanted and ranks lowest."""
    chosen = min((row for row in rows if wanted(row)), key=rank, default=None)
    if chosen is None:
        return None
    box = tuple(chosen[f"full_{side}_px"] for side in ("x_min", "y_min", "x_max", "y_max"))
    return Moment(chosen["step"], chosen["camera"], box, f"{chosen['vessel']}: {say(chosen)}")


def _fraction(row: dict[str, Any]) -> float:
    return 1.0 if row["visible_fraction"] is None else row["visible_fraction"]


def _hidden(row: dict[str, Any]) -> bool:
    return bool(row["occluded_by"]) and 0 < _fraction(row) < 1


def _clear(row: dict[str, Any]) -> bool:
    return bool(_fraction(row) == 1 and row["annotated"])


def _hider(row: dict[str, Any]) -> str:
    hider = max(row["occluded_by"], key=lambda entry: entry["px"])["id"]
    if _fraction(row) == 0:
        return f"wholly hidden by {hider}"
    hidden = min(1 - _fraction(row), 0.99)  # something is seen: "100 %" would be another thing
    return f"{hidden:.0%} hidden by {hider}, {'detected' if row['detected'] else 'missed'}"


def _false_alarm(truth: list[dict[str, Any]], detections: list[dict[str, Any]]) -> Moment | None:
    """The largest false positive."""
    false = [row for row in detections if row["vessel"] is None]
    row = max(false, key=lambda row: row["width_px"] * row["height_px"], default=None)
    if row is None:
        return None
    half = row["width_px"] / 2, row["height_px"] / 2
    box = (row["x_px"] - half[0], row["y_px"] - half[1], row["x_px"] + half[0], row["y_px"] + half[1])
    return Moment(row["step"], row["camera"], box, "a false positive")
