"""The truth record: what cameras see of vessels, as columns that are the same for every source of truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, ranges
from modsim3d.core.boxes import sizes


@dataclass(frozen=True, eq=False)
class Truth:
    """Truth of cameras about vessels: n rows, one for each camera, step and vessel whose silhouette is in the image.

    Boxes are x_min, y_min, x_max, y_max. Rows are in order of step, camera, vessel.

    Attributes:
        step: Step of the scene, shape (n,).
        camera: Index into the scene's cameras, shape (n,).
        vessel: Index into the scene's vessels, shape (n,).
        full_boxes_px: Tight box of the whole silhouette, hidden parts too, cut at the image edge, shape (n, 4).
        visible_boxes_px: Tight box of what is visible; NaN if nothing is, or if the source cannot tell, shape (n, 4).
        silhouette_px: Number of pixels of the whole silhouette in the image, shape (n,).
        visible_px: Number of these that are visible; NaN if the source cannot tell, shape (n,).
        visible_fraction: visible_px / silhouette_px; NaN if there is no silhouette pixel, shape (n,).
        in_frame_fraction: Share of the silhouette's area that is in the image; NaN if the near plane cuts the solid,
            shape (n,).
        depth_m: Mean c3 of the corner points, shape (n,).
        occluder_offsets: Entries offsets[i] to offsets[i + 1] − 1 of the next two columns are what hides row i, shape
            (n + 1,).
        occluder: Index into the scene's occluder names, shape (m,).
        occluder_px: Number of pixels of the row that this occluder hides, shape (m,).
        annotated: Whether the annotation mode and filters keep the row, shape (n,).
        drawn: Whether OpenGL has drawn the row, rather than exact spans; false in a truth from a table, shape (n,).
        intersections: Step, camera and two occluders, a vessel among them, that overlap in the image and whose hulls
            intersect, so that the analytic source cannot tell what is visible of them, shape (k, 4).
    """

    step: Indices
    camera: Indices
    vessel: Indices
    full_boxes_px: Array
    visible_boxes_px: Array
    silhouette_px: Array
    visible_px: Array
    visible_fraction: Array
    in_frame_fraction: Array
    depth_m: Array
    occluder_offsets: Indices
    occluder: Indices
    occluder_px: Array
    annotated: Mask
    drawn: Mask
    intersections: Indices

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.step)

    def take(self, rows: Indices | Mask | slice) -> Truth:
        """The chosen rows, given by indices, shape (k,), a mask, shape (n,), or a slice, in the order given."""
        chosen = np.arange(len(self))[rows]
        counts = np.diff(self.occluder_offsets)[chosen]
        entries = ranges(self.occluder_offsets[chosen], counts)
        columns = {name: getattr(self, name)[chosen] for name in ROW_COLUMNS}
        return Truth(
            **columns,
            occluder_offsets=np.concatenate([[0], np.cumsum(counts)]),
            occluder=self.occluder[entries],
            occluder_px=self.occluder_px[entries],
            intersections=self.intersections,
        )

    def of_camera(self, camera: int) -> Truth:
        """The rows of one camera, by its index."""
        rows = self.camera == camera
        return self if rows.all() else self.take(rows)

    def with_annotated(self, annotated: Mask) -> Truth:
        """Truth with another column `annotated`, shape (n,)."""
        return replace(self, annotated=annotated)

    def occluders_of(self, row: int) -> list[tuple[int, float]]:
        """Who hides how many pixels of a row, as pairs (index into the scene's occluder names, pixels)."""
        entries = slice(self.occluder_offsets[row], self.occluder_offsets[row + 1])
        return list(zip(self.occluder[entries].tolist(), self.occluder_px[entries].tolist(), strict=True))


COLUMNS = tuple(field.name for field in fields(Truth))
ROW_COLUMNS = tuple(
    name for name in COLUMNS if name not in ("occluder_offsets", "occluder", "occluder_px", "intersections")
)


def no_truth() -> Truth:
    """A record without rows."""
    columns: dict[str, Any] = {
        **dict.fromkeys(COLUMNS, np.empty(0)),
        **dict.fromkeys(("step", "camera", "vessel", "occluder"), np.empty(0, dtype=np.int64)),
        **dict.fromkeys(("full_boxes_px", "visible_boxes_px"), np.empty((0, 4))),
        "occluder_offsets": np.zeros(1, dtype=np.int64),
        **dict.fromkeys(("annotated", "drawn"), np.empty(0, dtype=bool)),
        "intersections": np.empty((0, 4), dtype=np.int64),
    }
    return Truth(**columns)


def concatenate(parts: Sequence[Truth]) -> Truth:
    """The rows of several records, at least one, in order of step, camera and vessel; each has this order already."""
    if len(parts) == 1:
        return parts[0]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ROW_COLUMNS}
    counts = np.concatenate([np.diff(part.occluder_offsets) for part in parts])
    truth = Truth(
        **joined,
        occluder_offsets=np.concatenate([[0], np.cumsum(counts)]),
        occluder=np.concatenate([part.occluder for part in parts]),
        occluder_px=np.concatenate([part.occluder_px for part in parts]),
        intersections=np.concatenate([part.intersections for part in parts]),
    )
    return truth.take(np.lexsort((truth.vessel, truth.camera, truth.step)))


# ---- Which vessels are annotated ----

SOURCES = ("rendered", "analytic", "rectangles")


@dataclass(frozen=True)
class Annotation:
    """How vessels are annotated.

    Attributes:
        mode: 0: the full box of every vessel in the image, hidden or not; 1: the full box of every vessel with a
            visible pixel; 2: the visible box of every vessel with a visible pixel.
        source: Where the truth comes from: one of `SOURCES`.
        supersample: Buffer pixels per image pixel and axis (rendered source).
        render: `regions` draws only where vessels overlap, `full` draws whole images; the truth is the same.
        min_visible_px: A vessel with fewer visible pixels is not annotated.
        min_visible_fraction: A vessel with a smaller visible fraction is not annotated.
        min_box_px: A vessel whose box is narrower or lower is not annotated.
        check: How many frames the cross-check draws: a `sample`, `all`, or none (`off`).
        allow_camera_inside: Whether a camera may be inside another vessel's volume.
    """

    mode: int = 0
    source: str = "rendered"
    supersample: int = 1
    render: str = "regions"
    min_visible_px: float = 0.0
    min_visible_fraction: float = 0.0
    min_box_px: float = 0.0
    allow_camera_inside: bool = False
    check: str = "sample"


def annotation_boxes(truth: Truth, mode: int) -> Array:
    """The box that a mode annotates in each of n rows, in pixels, shape (n, 4); NaN where there is none."""
    return truth.visible_boxes_px if mode == 2 else truth.full_boxes_px


def annotated_rows(truth: Truth, annotation: Annotation) -> Mask:
    """Whether the mode and the filters keep each of n rows, shape (n,)."""
    boxes = annotation_boxes(truth, annotation.mode)
    big_enough = sizes(boxes) >= annotation.min_box_px  # false for a missing box, which is NaN
    keep: Mask = np.all(big_enough, axis=1)
    # An unknown value (NaN) fails a filter, so it is compared only if the filter is set.
    if annotation.min_visible_px > 0:
        keep &= truth.visible_px >= annotation.min_visible_px
    if annotation.min_visible_fraction > 0:
        keep &= truth.visible_fraction >= annotation.min_visible_fraction
    if annotation.mode > 0:
        keep &= truth.visible_px > 0
    return keep
