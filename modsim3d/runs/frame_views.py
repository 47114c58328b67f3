"""A frame in other forms: words, a notebook's tables and picture, and what the library `supervision` takes."""

from __future__ import annotations

import io
from collections import Counter
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from modsim3d.arrays import Array
from modsim3d.display import column_table, counted, listed
from modsim3d.errors import ModsimError

if TYPE_CHECKING:
    from modsim3d.runs.blocks import Frame, FrameDetections, FrameTruth

PICTURE_DPI = 100


def frame_in_words(frame: Frame) -> str:
    """Camera, step and time, and how much is in it."""
    return (
        f"camera {frame.camera}, step {frame.step}, {frame.time_s:g} s, detector {frame.state}: "
        f"{counted(len(frame.truth), 'vessel')}, {counted(len(frame.detections), 'detection')}"
    )


def truth_in_words(truth: FrameTruth) -> str:
    """The vessels, and how many of them are annotated and detected."""
    names = f" ({listed(truth.vessels)})" if len(truth) else ""
    return (
        f"{counted(len(truth), 'vessel')}{names}, {np.count_nonzero(truth.annotated)} annotated, "
        f"{np.count_nonzero(truth.detected)} detected"
    )


def detections_in_words(detections: FrameDetections) -> str:
    """How many there are, and of what kinds."""
    kinds = [f"{count} {kind}" for kind, count in Counter(detections.kinds).items()]
    return counted(len(detections), "detection") + (f" ({', '.join(kinds)})" if kinds else "")


def truth_html(truth: FrameTruth) -> str:
    """A row for each vessel."""
    rows = [
        (
            truth.vessels[i],
            truth.labels[i],
            _box(truth.boxes_px[i]),
            f"{truth.visible_fraction[i]:.0%}" if np.isfinite(truth.visible_fraction[i]) else "–",
            "yes" if truth.annotated[i] else "no",
            "yes" if truth.detected[i] else "no",
        )
        for i in range(len(truth))
    ]
    header = ("vessel", "label", "box [px]", "visible", "annotated", "detected")
    return column_table(f"Truth: {truth_in_words(truth)}", header, rows)


def detections_html(detections: FrameDetections) -> str:
    """A row for each detection."""
    rows = [
        (
            detections.labels[i],
            f"{detections.confidence[i]:.2f}",
            _box(detections.boxes_px[i]),
            detections.kinds[i],
            detections.vessels[i] or "–",
        )
        for i in range(len(detections))
    ]
    header = ("label", "confidence", "box [px]", "kind", "vessel")
    return column_table(f"Detections: {detections_in_words(detections)}", header, rows)


def _box(box_px: Array) -> str:
    return ", ".join(f"{side:.1f}" for side in box_px) if np.isfinite(box_px).all() else "–"


def frame_html(frame: Frame) -> str | None:
    """Both tables; None where the frame can show its picture instead."""
    if can_be_drawn():
        return None
    return f"<p>{escape(frame_in_words(frame))}</p>{truth_html(frame.truth)}{detections_html(frame.detections)}"


def frame_png(frame: Frame) -> bytes | None:
    """The picture of `frame.plot()`; None without matplotlib."""
    if not can_be_drawn():
        return None
    picture = io.BytesIO()
    frame.plot().savefig(picture, format="png", dpi=PICTURE_DPI)
    return picture.getvalue()


def can_be_drawn() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def supervision_detections(frame: Frame) -> Any:
    """The detections as `supervision.Detections`; see `Frame.to_supervision`."""
    found = frame.detections
    return _supervision().Detections(
        xyxy=found.boxes_px.copy(),
        confidence=found.confidence.copy(),
        class_id=found.class_id.copy(),
        data={"class_name": np.array(found.labels, dtype=str)},
    )


def supervision_truth(frame: Frame) -> Any:
    """The annotated vessels as `supervision.Detections`; see `Frame.truth_to_supervision`."""
    truth = frame.truth
    rows = np.flatnonzero(truth.annotated)
    numbers = {name: number for number, name in enumerate(frame.scene_vessels)}
    return _supervision().Detections(
        xyxy=truth.boxes_px[rows],
        class_id=truth.class_id[rows],
        tracker_id=np.array([numbers[truth.vessels[row]] for row in rows], dtype=np.int64),
        data={
            "class_name": np.array([truth.labels[row] for row in rows], dtype=str),
            "vessel": np.array([truth.vessels[row] for row in rows], dtype=str),
        },
    )


def _supervision() -> Any:
    try:
        import supervision
    except ImportError:
        raise ModsimError("this needs the library supervision: pip install 'modsim3d[supervision]'") from None
    return supervision
