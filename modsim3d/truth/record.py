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
    """Truth of cameras about vessels: n rows, one for each camera, step and vessel whose silhouette is in the image, in
    order of step, camera, vessel. Boxes are x_min, y_min, x_max, y_max."""

    step: Indices  # of the scene, shape (n,)
    camera: Indices  # index into the scene's cameras, shape (n,)
    vessel: Indices  # index into the scene's vessels, shape (n,)
    full_boxes_px: Array  # tight box of the whole silhouette, hidden parts too, cut at the image edge, shape (n, 4)
    visible_boxes_px: Array  # of what is visible; NaN if nothing is, or if the source cannot tell, shape (n, 4)
    silhouette_px: Array  # number of pixels of the whole silhouette in the image, shape (n,)
    visible_px: Array  # number of these that are visible; NaN if the source cannot tell, shape (n,)
    visible_fraction: Array  # visible_px / silhouette_px; NaN if there is no silhouette pixel, shape (n,)
    in_frame_fraction: Array  # share of the silhouette's area in the image; NaN if the near plane cuts it, shape (n,)
    depth_m: Array  # mean c3 of the corner points, shape (n,)
    # Entries offsets[i] to offsets[i + 1] − 1 of the next two columns are what hides row i, shape (n + 1,).
    occluder_offsets: Indices
    occluder: Indices  # index into the scene's occluder names, shape (m,)
    occluder_px: Array  # number of pixels of the row that this occluder hides, shape (m,)
    annotated: Mask  # whether the annotation mode and filters keep the row, shape (n,)
    drawn: Mask  # whether OpenGL has drawn it, rather than exact spans; false in a truth from a table, shape (n,)
    # Step, camera and two occluders, a vessel among them, that overlap in the image and whose hulls intersect, so that
    # the analytic source cannot tell what is visible of them, shape (k, 4).
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
        """Pairs (index into the scene's occluder names, number of pixels of a row that it hides)."""
        entries = slice(self.occluder_offsets[row], self.occluder_offsets[row + 1])
        return list(zip(self.occluder[entries].tolist(), self.occluder_px[entries].tolist(), strict=True))


COLUMNS = tuple(field.name for field in fields(Truth))
_OTHERS = ("occluder_offsets", "occluder", "occluder_px", "intersections")
ROW_COLUMNS = tuple(name for name in COLUMNS if name not in _OTHERS)


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


SOURCES = ("rendered", "analytic", "rectangles")


@dataclass(frozen=True)
class Annotation:
    """Rules by which vessels are annotated."""

    # 0: the full box of every vessel in the image, hidden or not; 1: the full box of every vessel with a visible pixel;
    # 2: the visible box of every vessel with a visible pixel.
    mode: int = 0
    source: str = "rendered"  # where the truth comes from: one of `SOURCES`
    supersample: int = 1  # buffer pixels per image pixel and axis (rendered source)
    render: str = "regions"  # `regions` draws only where vessels overlap, `full` whole images; the truth is the same
    min_visible_px: float = 0.0  # a vessel with fewer visible pixels is not annotated
    min_visible_fraction: float = 0.0  # a vessel with a smaller visible fraction is not annotated
    min_box_px: float = 0.0  # a vessel whose box is narrower or lower is not annotated
    allow_camera_inside: bool = False  # whether a camera may be inside another vessel's volume
    check: str = "sample"  # frames that the cross-check draws: a `sample`, `all`, or none (`off`)


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
