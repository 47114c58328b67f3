"""The truth record: the same columns whatever made them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np

from modsim3d.arrays import Array, Indices, Mask


@dataclass(frozen=True, eq=False)
class Truth:
    """What cameras see of vessels: n rows, one for each camera, step and vessel whose silhouette is in the image.

    Boxes are x_min, y_min, x_max, y_max. Rows are in order of step, camera, vessel.

    Attributes:
        step: Shape (n,).
        camera: Index into the scene's cameras, shape (n,).
        vessel: Index into the scene's vessels, shape (n,).
        full_boxes_px: Tight box of the whole silhouette, hidden parts too, cut at the image edge, shape (n, 4).
        visible_boxes_px: Tight box of what is seen; NaN if nothing is, or if the source cannot tell, shape (n, 4).
        silhouette_px: Pixels of the silhouette alone in the image, shape (n,).
        visible_px: Pixels of those that are seen; NaN if the source cannot tell, shape (n,).
        visible_fraction: visible_px / silhouette_px; NaN if there is no silhouette pixel, shape (n,).
        in_frame_fraction: Area in the image over area of the silhouette; NaN across the near plane, shape (n,).
        depth_m: Mean c3 of the corner points, shape (n,).
        occluder_offsets: Row i is hidden by entries offsets[i] to offsets[i + 1] of the next two, shape (n + 1,).
        occluder: Index into `occluder_names` of the scene, shape (m,).
        occluder_px: How many of its pixels that one hides, shape (m,).
        annotated: Whether the annotation mode and filters keep it, shape (n,).
        intersections: Step, camera and two vessels that overlap in the image and in space, so that the analytic
            source knows nothing of what is visible of them, shape (k, 4).
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
    intersections: Indices

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.step)

    def take(self, rows: Indices | Mask | slice) -> Truth:
        """The rows chosen, in the order given."""
        chosen = np.arange(len(self))[rows]
        counts = np.diff(self.occluder_offsets)[chosen]
        offsets = np.concatenate([[0], np.cumsum(counts)])
        starts = np.repeat(self.occluder_offsets[chosen] - offsets[:-1], counts)
        entries = starts + np.arange(offsets[-1])
        columns = {name: getattr(self, name)[chosen] for name in ROW_COLUMNS}
        return Truth(
            **columns,
            occluder_offsets=offsets,
            occluder=self.occluder[entries],
            occluder_px=self.occluder_px[entries],
            intersections=self.intersections,
        )

    def with_annotated(self, annotated: Mask) -> Truth:
        """The same rows with another choice of what is annotated."""
        return replace(self, annotated=annotated)

    def occluders_of(self, row: int) -> list[tuple[int, float]]:
        """Who hides how many pixels of a row: (index into the scene's occluder names, pixels)."""
        entries = slice(self.occluder_offsets[row], self.occluder_offsets[row + 1])
        return list(zip(self.occluder[entries].tolist(), self.occluder_px[entries].tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Hidden:
    """Who hides how much: m entries, ordered by the hidden row and then by vessel.

    Attributes:
        row: The hidden row, shape (m,).
        vessel: Index into the scene's vessels of what is in front, shape (m,).
        px: How many pixels of the row it hides, shape (m,).
    """

    row: Indices
    vessel: Indices
    px: Array

    @classmethod
    def of(cls, row: Indices, vessel: Indices, px: Array) -> Hidden:
        """Put entries in order, and those of the same row and vessel together: it may be there in several parts."""
        order = np.lexsort((vessel, row))
        row, vessel, px = row[order], vessel[order], px[order]
        first = np.flatnonzero((np.diff(row, prepend=-1) != 0) | (np.diff(vessel, prepend=-1) != 0))
        if len(first) < len(row):
            row, vessel, px = row[first], vessel[first], np.add.reduceat(px, first)
        return cls(row, vessel, px)

    def of_rows(self, rows: Indices, count: int) -> Hidden:
        """The entries of the rows chosen, which ascend, of `count`; they count anew."""
        place = np.full(count, -1)
        place[rows] = np.arange(len(rows))
        kept = place[self.row] >= 0
        return Hidden(place[self.row][kept], self.vessel[kept], self.px[kept])

    def offsets(self, count: int) -> Indices:
        """Where the entries of each of `count` rows begin, and the end, shape (count + 1,)."""
        return np.searchsorted(self.row, np.arange(count + 1))


@dataclass(frozen=True, eq=False)
class Occlusion:
    """What a source says is seen of n outlines; the columns of `Truth` with the same names.

    Attributes:
        full_boxes_px: Shape (n, 4).
        visible_boxes_px: Shape (n, 4).
        silhouette_px: Shape (n,).
        visible_px: Shape (n,).
        hidden: Who hides how much of which row.
        intersecting: Pairs of rows whose solids intersect, shape (k, 2).
    """

    full_boxes_px: Array
    visible_boxes_px: Array
    silhouette_px: Array
    visible_px: Array
    hidden: Hidden
    intersecting: Indices = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))

    @property
    def occluders(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """For each row, who hides how much of it: (index into the scene's vessels, pixels)."""
        offsets = self.hidden.offsets(len(self.silhouette_px)).tolist()
        entries = list(zip(self.hidden.vessel.tolist(), self.hidden.px.tolist(), strict=True))
        return tuple(tuple(entries[first:stop]) for first, stop in pairwise(offsets))

    def take(self, rows: Indices) -> Occlusion:
        """The rows chosen, which ascend; of intersecting pairs those of which both are."""
        count = len(self.silhouette_px)
        place = np.full(count, -1)
        place[rows] = np.arange(len(rows))
        pairs = place[self.intersecting]
        return Occlusion(
            full_boxes_px=self.full_boxes_px[rows],
            visible_boxes_px=self.visible_boxes_px[rows],
            silhouette_px=self.silhouette_px[rows],
            visible_px=self.visible_px[rows],
            hidden=self.hidden.of_rows(rows, count),
            intersecting=pairs[(pairs >= 0).all(axis=1)],
        )

    def among(self, rows: Indices, count: int) -> Occlusion:
        """The same as `rows` of `count`, of which nothing else is known: NaN, and nobody that hides."""

        def spread(column: Array) -> Array:
            wide = np.full((count, *column.shape[1:]), np.nan)
            wide[rows] = column
            return wide

        hidden = Hidden(rows[self.hidden.row], self.hidden.vessel, self.hidden.px)
        full, visible = spread(self.full_boxes_px), spread(self.visible_boxes_px)
        return Occlusion(
            full, visible, spread(self.silhouette_px), spread(self.visible_px), hidden, rows[self.intersecting]
        )

    def visible_fraction(self) -> Array:
        """visible_px / silhouette_px; NaN where there is no silhouette pixel, shape (n,)."""
        whole = np.where(self.silhouette_px > 0, self.silhouette_px, np.nan)
        return self.visible_px / whole

    def truth(self, step: Indices, camera: int, vessel: Indices, in_frame_fraction: Array, depth_m: Array) -> Truth:
        """The truth record of one camera, with nothing annotated yet.

        Args:
            step: Of each row, shape (n,).
            camera: Index into the scene's cameras.
            vessel: Index into the scene's vessels, shape (n,).
            in_frame_fraction: Shape (n,).
            depth_m: Shape (n,).
        """
        return Truth(
            step=step,
            camera=np.full(len(step), camera, dtype=np.int64),
            vessel=vessel,
            full_boxes_px=self.full_boxes_px,
            visible_boxes_px=self.visible_boxes_px,
            silhouette_px=self.silhouette_px,
            visible_px=self.visible_px,
            visible_fraction=self.visible_fraction(),
            in_frame_fraction=in_frame_fraction,
            depth_m=depth_m,
            occluder_offsets=self.hidden.offsets(len(step)),
            occluder=self.hidden.vessel,
            occluder_px=self.hidden.px,
            annotated=np.zeros(len(step), dtype=bool),
            intersections=np.column_stack(
                [step[self.intersecting[:, 0]], np.full(len(self.intersecting), camera), vessel[self.intersecting]]
            ),
        )


COLUMNS = tuple(field.name for field in fields(Truth))
ROW_COLUMNS = tuple(
    name for name in COLUMNS if name not in ("occluder_offsets", "occluder", "occluder_px", "intersections")
)


def no_truth() -> Truth:
    """The record of no frame."""
    integers, numbers, boxes = np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, 4))
    return Truth(
        step=integers,
        camera=integers,
        vessel=integers,
        full_boxes_px=boxes,
        visible_boxes_px=boxes,
        silhouette_px=numbers,
        visible_px=numbers,
        visible_fraction=numbers,
        in_frame_fraction=numbers,
        depth_m=numbers,
        occluder_offsets=np.zeros(1, dtype=np.int64),
        occluder=integers,
        occluder_px=numbers,
        annotated=np.empty(0, dtype=bool),
        intersections=np.empty((0, 4), dtype=np.int64),
    )


def concatenate(parts: Sequence[Truth]) -> Truth:
    """The rows of several records in order of step, camera and vessel.

    Args:
        parts: At least one.
    """
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
