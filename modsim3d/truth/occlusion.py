"""Occlusion by one source of truth: boxes, pixel counts, and who hides how much of whom."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, run_starts
from modsim3d.truth.outlines import Outlines, new_numbers
from modsim3d.truth.record import Truth


@dataclass(frozen=True, eq=False)
class HiddenPixels:
    """Numbers of hidden pixels: m entries, ordered by hidden row and then by occluder, each pair of them once."""

    row: Indices  # the hidden row, shape (m,)
    occluder: Indices  # what is in front, as an index into the scene's occluder names, shape (m,)
    px: Array  # number of pixels of the row that it hides, shape (m,)

    @classmethod
    def of(cls, row: Indices, occluder: Indices, px: Array) -> HiddenPixels:
        """Sort entries, all of shape (m,), and add up those of the same row and occluder, of which there are several
        because an obstacle may consist of several solids."""
        if not len(row):
            return cls(row, occluder, px)
        order = np.lexsort((occluder, row))
        row, occluder, px = row[order], occluder[order], px[order]
        first = run_starts(row, occluder)
        if len(first) < len(row):
            row, occluder, px = row[first], occluder[first], np.add.reduceat(px, first)
        return cls(row, occluder, px)

    def offsets(self, count: int) -> Indices:
        """Index of the first entry of each of `count` rows, and the number of entries last, shape (count + 1,)."""
        return np.searchsorted(self.row, np.arange(count + 1))


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Occlusion of the n rows of `Outlines` by a source. Columns mean the same as those of `Truth` with their names."""

    full_boxes_px: Array  # shape (n, 4)
    visible_boxes_px: Array  # shape (n, 4)
    silhouette_px: Array  # shape (n,)
    visible_px: Array  # shape (n,)
    hidden: HiddenPixels
    # Pairs of rows whose solids intersect, shape (k, 2).
    intersecting: Indices = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    drawn: Mask | None = None  # which rows OpenGL has drawn, shape (n,); None for a source that draws nothing

    @classmethod
    def joined(cls, parts: list[Occlusion]) -> Occlusion:
        """Occlusion of the rows of several parts, one part after another."""
        counts = [len(part.silhouette_px) for part in parts]
        before = np.cumsum(counts) - counts
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS}
        offset = list(zip(parts, before, strict=True))
        hidden = HiddenPixels(
            np.concatenate([part.hidden.row + first for part, first in offset]),
            np.concatenate([part.hidden.occluder for part in parts]),
            np.concatenate([part.hidden.px for part in parts]),
        )
        intersecting = np.concatenate([part.intersecting + first for part, first in offset])
        drawn = np.concatenate([part.was_drawn() for part in parts])
        return cls(**columns, hidden=hidden, intersecting=intersecting, drawn=drawn)

    @property
    def occluders(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """Occluders of each row and how much each hides: (index into the scene's occluder names, pixels)."""
        offsets = self.hidden.offsets(len(self.silhouette_px)).tolist()
        entries = list(zip(self.hidden.occluder.tolist(), self.hidden.px.tolist(), strict=True))
        return tuple(tuple(entries[first:stop]) for first, stop in pairwise(offsets))

    def take(self, rows: Indices) -> Occlusion:
        """The chosen rows, shape (k,), which ascend, and the intersecting pairs of which both rows are chosen."""
        place = new_numbers(rows, len(self.silhouette_px))
        pairs, hidden_row = place[self.intersecting], place[self.hidden.row]
        kept = hidden_row >= 0
        return Occlusion(
            **{name: getattr(self, name)[rows] for name in _COLUMNS},
            hidden=HiddenPixels(hidden_row[kept], self.hidden.occluder[kept], self.hidden.px[kept]),
            intersecting=pairs[(pairs >= 0).all(axis=1)],
            drawn=self.was_drawn()[rows],
        )

    def was_drawn(self) -> Mask:
        """Whether OpenGL has drawn each row, shape (n,)."""
        return np.zeros(len(self.silhouette_px), dtype=bool) if self.drawn is None else self.drawn

    def visible_fraction(self) -> Array:
        """visible_px / silhouette_px, NaN where there is no silhouette pixel, shape (n,)."""
        whole = np.where(self.silhouette_px > 0, self.silhouette_px, np.nan)
        return self.visible_px / whole

    def truth(self, outlines: Outlines, steps: Indices, camera: int) -> Truth:
        """The truth record of one camera's vessels, with nothing annotated yet. Of the n rows of the outlines that this
        occlusion describes, those without a box are left out; `steps` is the step of the scene of each frame of the
        outlines, shape (frames,), and `camera` an index into the scene's cameras."""
        step = steps[outlines.frame]
        pair_step, pair_camera = step[self.intersecting[:, 0]], np.full(len(self.intersecting), camera)
        truth = Truth(
            step=step,
            camera=np.full(len(step), camera, dtype=np.int64),
            vessel=outlines.occluder,  # vessels come first among the occluders
            full_boxes_px=self.full_boxes_px,
            visible_boxes_px=self.visible_boxes_px,
            silhouette_px=self.silhouette_px,
            visible_px=self.visible_px,
            visible_fraction=self.visible_fraction(),
            in_frame_fraction=outlines.in_frame_fraction,
            depth_m=outlines.depth_m,
            occluder_offsets=self.hidden.offsets(len(step)),
            occluder=self.hidden.occluder,
            occluder_px=self.hidden.px,
            annotated=np.zeros(len(step), dtype=bool),
            drawn=self.was_drawn(),
            intersections=np.column_stack([pair_step, pair_camera, outlines.occluder[self.intersecting]]),
        )
        return truth if outlines.boxed.all() else truth.take(outlines.boxed)


_COLUMNS = ("full_boxes_px", "visible_boxes_px", "silhouette_px", "visible_px")
