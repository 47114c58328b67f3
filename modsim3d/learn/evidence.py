"""What a run shows of its detector: the columns of all cameras joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import at_least_a_pixel
from modsim3d.detector.census import TargetCensus, take_census
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Detections, Frames, Targets

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class Seen:
    """What one camera's detector was given over a whole run, and what it put out."""

    frames: Frames
    targets: Targets
    detections: Detections


@dataclass(frozen=True, eq=False)
class Chances:
    """Every chance to detect a vessel: n annotated boxes of all cameras.

    Attributes:
        camera: Index of the camera, shape (n,).
        time_s: Shape (n,).
        frame: Index of the camera's frame, shape (n,).
        vessel: Index of the vessel, shape (n,).
        state: Shape (n,).
        label: True label, shape (n,).
        outcome: The label that it was detected under; −1 where it was missed, −2 where it was detected in another's box
            and nobody knows as what, shape (n,).
        before: Row of the same vessel in the camera's frame before, −1 if it was not annotated there, shape (n,).
        boxes_px: The boxes that errors are added to, shape (n, 4).
        image_px: Width and height of the camera's image, shape (n, 2).
        visible_fraction: NaN where unknown, shape (n,).
        depth_m: Shape (n,).
    """

    camera: Indices
    time_s: Array
    frame: Indices
    vessel: Indices
    state: Indices
    label: Indices
    outcome: Indices
    before: Indices
    boxes_px: Array
    image_px: Array
    visible_fraction: Array
    depth_m: Array


@dataclass(frozen=True, eq=False)
class Hits:
    """True detections, m rows: one of each vessel that is seen, two of them in one box where they are merged.

    Attributes:
        chance: Row of `Chances` that each came from, shape (m,).
        kind: Index into `KINDS`, shape (m,).
        errors_px: e_x, e_y, e_w, e_h before clipping, NaN where it is not one box of one vessel, shape (m, 4).
        confidence: Shape (m,).
        boxes_px: As put out, shape (m, 4).
    """

    chance: Indices
    kind: Indices
    errors_px: Array
    confidence: Array
    boxes_px: Array


@dataclass(frozen=True, eq=False)
class Clutter:
    """False positives, m rows; second boxes of vessels among them.

    Attributes:
        image: Index into `Images`, shape (m,).
        chance: Row of `Chances` of a second box, −1 for all others, shape (m,).
        state: Shape (m,).
        label: Shape (m,).
        confidence: Shape (m,).
        kind: Index into `KINDS`, shape (m,).
        boxes_px: As put out, shape (m, 4).
    """

    image: Indices
    chance: Indices
    state: Indices
    label: Indices
    confidence: Array
    kind: Indices
    boxes_px: Array


@dataclass(frozen=True, eq=False)
class Images:
    """Every camera's frames, s rows in order of camera and time.

    Attributes:
        camera: Shape (s,).
        time_s: Shape (s,).
        step: Shape (s,).
        state: Shape (s,).
        n_kept: True detections, shape (s,).
        n_false: False positives, shape (s,).
    """

    camera: Indices
    time_s: Array
    step: Indices
    state: Indices
    n_kept: Indices
    n_false: Indices


@dataclass(frozen=True, eq=False)
class Evidence:
    """A whole run, all cameras.

    Attributes:
        cameras: What each camera's detector was given and put out.
        images: Their frames.
        chances: Every annotated box.
        hits: True detections.
        clutter: False ones.
    """

    cameras: tuple[Seen, ...]
    images: Images
    chances: Chances
    hits: Hits
    clutter: Clutter

    @classmethod
    def of(cls, cameras: Sequence[Seen]) -> Evidence:
        """Join what the cameras saw."""
        first_row = np.cumsum([0, *(len(seen.targets) for seen in cameras)])
        first_image = np.cumsum([0, *(len(seen.frames) for seen in cameras)])
        parts = [_camera(index, seen) for index, seen in enumerate(cameras)]
        chances = [part[1] for part in parts]
        hits = [part[2] for part in parts]
        clutter = [part[3] for part in parts]
        return cls(
            tuple(cameras),
            Images(**_joined([part[0] for part in parts])),
            Chances(**_joined(chances, {"before": first_row})),
            Hits(**_joined(hits, {"chance": first_row})),
            Clutter(**_joined(clutter, {"image": first_image, "chance": first_row})),
        )

    def census(self, model: DetectorModel) -> TargetCensus:
        """The census that the detector had of the scene."""
        return take_census(model, ((seen.frames, seen.targets) for seen in self.cameras))


def _joined(parts: Sequence[Columns], offsets: dict[str, Indices] | None = None) -> Columns:
    """Columns one below the other; those that index rows are moved on, −1 stays."""
    columns: Columns = {}
    for name in parts[0]:
        start = (offsets or {}).get(name)
        values = [
            part[name] if start is None else np.where(part[name] < 0, -1, part[name] + start[i])
            for i, part in enumerate(parts)
        ]
        columns[name] = np.concatenate(values)
    return columns


def _camera(index: int, seen: Seen) -> tuple[Columns, Columns, Columns, Columns]:
    frames, targets, found = seen.frames, seen.targets, seen.detections
    false = found.false()
    true = ~false
    outcome = np.full(len(targets), -1)
    outcome[found.partner[found.partner >= 0]] = -2
    outcome[found.target[true]] = found.label[true]
    length, state = len(frames), found.states
    images = {
        "camera": np.full(length, index),
        "time_s": frames.times_s,
        "step": frames.steps,
        "state": state,
        "n_kept": np.bincount(found.frame[true], minlength=length),
        "n_false": np.bincount(found.frame[false], minlength=length),
    }
    chances = {
        "camera": np.full(len(targets), index),
        "time_s": frames.times_s[targets.frame],
        "frame": targets.frame,
        "vessel": targets.vessel,
        "state": state[targets.frame],
        "label": targets.label,
        "outcome": outcome,
        "before": _rows_before(targets),
        "boxes_px": at_least_a_pixel(targets.boxes_px, frames.image_size_px),
        "image_px": np.tile(np.array(frames.image_size_px, dtype=np.float64), (len(targets), 1)),
        "visible_fraction": targets.visible_fraction,
        "depth_m": targets.depth_m,
    }
    hits = {
        "chance": found.target[true],
        "kind": found.kind[true],
        "errors_px": found.errors_px[true],
        "confidence": found.confidence[true],
        "boxes_px": found.boxes_px[true],
    }
    clutter = {
        "image": found.frame[false],
        "chance": found.target[false],
        "state": state[found.frame[false]],
        "label": found.label[false],
        "confidence": found.confidence[false],
        "kind": found.kind[false],
        "boxes_px": found.boxes_px[false],
    }
    return images, chances, hits, clutter


def _rows_before(targets: Targets) -> Indices:
    """Row of the same vessel in the frame before, −1 if there is none, shape (n,)."""
    order = np.lexsort((targets.frame, targets.vessel))
    vessel, frame = targets.vessel[order], targets.frame[order]
    follows = (vessel[1:] == vessel[:-1]) & (frame[1:] == frame[:-1] + 1)
    before = np.full(len(targets), -1)
    before[order[1:][follows]] = order[:-1][follows]
    return before
