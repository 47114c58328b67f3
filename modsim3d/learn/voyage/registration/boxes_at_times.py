"""Boxes that a detector wrote in frames, with the times of its own clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import clip, sizes
from modsim3d.core.errors import ModsimError
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, same_frame
from modsim3d.learn.voyage.registration.parameters import Values


@dataclass(frozen=True, eq=False)
class BoxesAtTimes:
    """n detected boxes in F frames of one camera, those without boxes included. Times by the detector's clock count as
    the scene does: from its first step on."""

    times_s: Array  # of each frame, ascending, (F,)
    frame: Indices  # of each box, (n,)
    boxes_px: Array  # left, top, right and bottom edge, (n, 4)

    def __post_init__(self) -> None:
        """Raise ModsimError if shapes do not fit, times do not ascend, a box has no frame, or a number is infinite."""
        count = len(self.frame)
        if self.times_s.ndim != 1 or self.boxes_px.shape != (count, 4):
            found = f"times {self.times_s.shape}, frames {self.frame.shape}, boxes {self.boxes_px.shape}"
            raise ModsimError(f"detections: shapes (F,), (n,) and (n, 4) are needed (got {found})")
        if not (np.isfinite(self.times_s).all() and np.isfinite(self.boxes_px).all()):
            raise ModsimError("detections: a time or an edge of a box is not a finite number")
        if np.any(np.diff(self.times_s) <= 0):
            at = int(np.flatnonzero(np.diff(self.times_s) <= 0)[0])
            after = f"{self.times_s[at + 1]:g} s follows {self.times_s[at]:g} s"
            raise ModsimError(f"detections: the times of frames must ascend, but {after}")
        if count and not 0 <= self.frame.min() <= self.frame.max() < len(self.times_s):
            raise ModsimError(f"detections: a box is in a frame that is not among the {len(self.times_s)} frames")

    def some(self, most_frames: int) -> BoxesAtTimes:
        """At most so many of the frames, evenly spread, with their boxes."""
        if len(self.times_s) <= most_frames:
            return self
        kept = np.unique(np.linspace(0, len(self.times_s) - 1, most_frames).round().astype(int))
        number = np.full(len(self.times_s), -1)
        number[kept] = np.arange(len(kept))
        inside = number[self.frame] >= 0
        return BoxesAtTimes(self.times_s[kept], number[self.frame][inside], self.boxes_px[inside])


# ---- Detections matched to vessels ----

EDGE_PX = 3.0  # an edge this near the image's border may be cut by it
FARTHEST = 0.75  # how far from the image's centre, in shares of its size, a point may be by the scene's own lens
SIZE_RATIO = 2.5
LESS_SURE = 0.5  # a match is clear if it is nearer, by this factor, than the next vessel and the next detection


@dataclass(frozen=True, eq=False)
class Sightings(Columns):
    """Matched detections, n rows in order of frame."""

    detection: Indices  # row of the detected box
    frame: Indices
    time_s: Array  # of the frame, by the detector's clock
    vessel: Indices
    boxes_px: Array  # detected left, top, right and bottom edge, (n, 4)
    usable: Mask  # which of these edges are neither cut by the image nor hidden, (n, 4)
    expected_px: Array  # the box that the values give with which it was matched, not cut at the image, (n, 4)
    corners_m: Array  # the vertex of the vessel that makes each edge, in VCF, (n, 4, 3)


@dataclass(frozen=True, eq=False)
class Predictions:
    """Places where the vessels' boxes should be in the frames, m rows in order of frame: all that overlap the image."""

    frame: Indices
    vessel: Indices
    boxes_px: Array
    corners_m: Array
    usable: Mask


def predict(model: BoxModel, hiding: HidingBodies, values: Values, times_s: Array) -> Predictions:
    """The boxes of all vessels in frames at times of the detector's clock, shape (F,), with some values."""
    vessels = len(model.hulls_m)
    frame, vessel = np.divmod(np.arange(len(times_s) * vessels), vessels)
    boxes, corners = model.boxes(values, times_s[frame], vessel)
    size = np.array(model.traffic.camera.intrinsics.image_size_px, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        shown = np.flatnonzero(np.all((boxes[:, 2:] > 0) & (boxes[:, :2] < size), axis=1))
    frame, vessel, boxes, corners = frame[shown], vessel[shown], boxes[shown], corners[shown]
    hidden = hiding.hidden(values, times_s[frame], vessel, corners, frame)
    seen = np.flatnonzero(~hidden.all(axis=1))
    tips = model.pixels(values, times_s[frame], vessel, corners)
    # Of a ship that a side of the image cuts, the highest and lowest points may lie beyond that side.
    usable = np.all((tips > EDGE_PX) & (tips < size - EDGE_PX), axis=-1) & ~hidden
    # A k1 below the scene's folds points from far outside into the image.
    straight = model.pixels(values.changed(k1=0.0), times_s[frame], vessel, corners)
    usable &= np.all(np.abs(straight / size - 0.5) < FARTHEST, axis=-1)
    return Predictions(frame[seen], vessel[seen], boxes[seen], corners[seen], usable[seen])


def inside(boxes_px: Array, size_px: Array) -> Mask:
    """Mask of the edges of boxes (n, 4) that are clear of the image's border."""
    return (boxes_px > EDGE_PX) & (boxes_px < np.tile(size_px, 2) - EDGE_PX)


def match(found: BoxesAtTimes, predicted: Predictions, size_px: tuple[int, int], gates_px: Array) -> Sightings:
    """Detections that are each other's nearest with a vessel of the same frame, and clearly so. The distance is that of
    the centre's column and the lower edge in shares of the gate, and that of the widths. `gates_px` are the greatest
    distances in columns and in rows of each predicted box, (m, 2)."""
    box, row = same_frame(found.frame, predicted.frame)
    detected, expected = found.boxes_px[box], clip(predicted.boxes_px, size_px)[row]
    gates = gates_px[row]
    across = (detected[:, [0, 2]] - expected[:, [0, 2]]).mean(axis=1) / gates[:, 0]
    down = (detected[:, 3] - expected[:, 3]) / gates[:, 1]
    widths = [np.maximum(sizes(boxes)[:, 0], 1.0) for boxes in (detected, expected)]
    wider = np.log(widths[0] / widths[1]) / np.log(SIZE_RATIO)
    distance = across**2 + down**2 + wider**2
    near = np.flatnonzero((np.abs(across) < 1) & (np.abs(down) < 1) & (np.abs(wider) < 1))
    box, row, distance = box[near], row[near], distance[near]
    clear = _clearest(box, distance) & _clearest(row, distance)
    box, row = box[clear], row[clear]
    order = np.lexsort((row, predicted.frame[row]))
    box, row = box[order], row[order]
    frame, boxes = predicted.frame[row], found.boxes_px[box]
    usable = predicted.usable[row] & inside(boxes, np.array(size_px, dtype=np.float64))
    columns = predicted.vessel[row], boxes, usable, predicted.boxes_px[row], predicted.corners_m[row]
    return Sightings(box, frame, found.times_s[frame], *columns)


def _clearest(owner: Indices, distance: Array) -> Mask:
    """Mask of the pairs that are the nearest of their owner, and nearer than the next by a factor."""
    order = np.lexsort((distance, owner))
    first = np.ones(len(order), dtype=bool)
    first[1:] = owner[order][1:] != owner[order][:-1]
    following = np.full(len(order), np.inf)
    following[:-1] = np.where(first[1:], np.inf, distance[order][1:])
    clear = np.zeros(len(order), dtype=bool)
    clear[order] = first & (distance[order] <= LESS_SURE * following)
    return clear
