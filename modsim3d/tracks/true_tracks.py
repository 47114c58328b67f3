"""What tracks are held against: the vessels in the images, each appearance of one as an identity."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.runs.files.columns import indices
from modsim3d.runs.run_rows import RunRows

TruthName = Literal["annotated", "full"]
DEFAULT_GAP_S = 2.0
"""After so long outside the image a vessel that comes back is a new identity."""
_TIME_S = 1e-6
"""Times are differences of rounded ones: an absence as long as the gap is no longer one."""


@dataclass(frozen=True, eq=False)
class TrueTracks:
    """The vessels in the images of a run: n rows in order of frame and vessel.

    A vessel of which no pixel is visible is there with the box of the whole vessel, and not scored: a track that
    stays on it is neither right nor wrong.

    Attributes:
        cameras: Number of cameras of the run.
        row: Row of the truth table, shape (n,).
        frame: Number of the frame, as in `RunRows`, shape (n,).
        vessel: Index of the vessel, shape (n,).
        identity: Number of the appearance: of one vessel in one camera, without a gap outside the image, shape (n,).
        label: Index of the vessel's true label, shape (n,).
        boxes_px: x_min, y_min, x_max, y_max, shape (n, 4).
        scored: Whether a tracker is expected to follow it here, shape (n,).
        hidden: Whether other things hide all of it, shape (n,).
    """

    cameras: int
    row: Indices
    frame: Indices
    vessel: Indices
    identity: Indices
    label: Indices
    boxes_px: Array
    scored: Mask
    hidden: Mask

    @classmethod
    def of(cls, rows: RunRows, truth: TruthName = "annotated", gap_s: float = DEFAULT_GAP_S) -> Self:
        """The truth of a run.

        Args:
            rows: The run.
            truth: `annotated`: the vessels that the detector was given, with the boxes of the annotation mode, and all
                others in the image as not scored; `full`: all vessels, with the boxes around all of each.
            gap_s: After so long outside the image a vessel that comes back is a new identity.
        """
        visible_px, silhouette_px = rows.numbers("visible_px"), rows.numbers("silhouette_px")
        unseen = visible_px == 0  # where it is unknown what is visible, nothing is taken as hidden
        scored, boxes_px = ~unseen, rows.boxes_px("full")
        if truth == "annotated":
            scored = scored & rows.annotated
            boxes_px = np.where(scored[:, None], rows.annotated_boxes_px, boxes_px)
        order = np.lexsort((rows.truth_vessel, rows.truth_frame))
        return cls(
            len(rows.scene.cameras),
            order,
            rows.truth_frame[order],
            rows.truth_vessel[order],
            appearances(rows, gap_s)[order],
            indices(rows.truth, "label", rows.scene.detector.labels)[order],
            boxes_px[order],
            scored[order],
            (unseen & (silhouette_px > 0))[order],
        )

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.frame)

    def take(self, chosen: Mask | Indices) -> Self:
        """The chosen rows."""
        columns = (getattr(self, field.name) for field in fields(self)[1:])
        return type(self)(self.cameras, *(column[chosen] for column in columns))


def appearances(rows: RunRows, gap_s: float) -> Indices:
    """Number of the appearance of each row of the truth, shape (n,).

    An appearance ends when the vessel leaves the image for longer than the gap, not when something hides it.
    """
    cameras, times_s = len(rows.scene.cameras), rows.scene.times_s(0, rows.steps)
    camera, step = rows.truth_frame % cameras, rows.truth_frame // cameras
    frame_of_camera = np.empty(len(step), dtype=np.int64)
    for index in range(cameras):
        taken = rows.frames[rows.frames % cameras == index]
        here = camera == index
        frame_of_camera[here] = np.searchsorted(taken, rows.truth_frame[here])
    order = np.lexsort((step, rows.truth_vessel, camera))
    other = (np.diff(camera[order]) != 0) | (np.diff(rows.truth_vessel[order]) != 0)
    away = (np.diff(frame_of_camera[order]) > 1) & (np.diff(times_s[step[order]]) > gap_s + _TIME_S)
    found = np.zeros(len(order), dtype=np.int64)
    found[order[1:]] = np.cumsum(other | away)
    return found
