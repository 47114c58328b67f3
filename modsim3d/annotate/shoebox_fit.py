"""How much looser a vessel's shoebox is than its mesh, as boxes in the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.annotate.outlines import Outlines
from modsim3d.arrays import Array
from modsim3d.boxes import sizes
from modsim3d.vessels import Vessel


@dataclass
class Looseness:
    """One vessel's full boxes of mesh and shoebox, summed over frames.

    Attributes:
        frames: In which the mesh is in the image.
        ratio_sum: Of area of the shoebox's box over area of the mesh's.
        ratio_max: The greatest.
        side_max_px: By how much a side of the shoebox's box is farther out at most.
        within_a_pixel: Frames in which no side is more than a pixel farther out.
    """

    frames: int = 0
    ratio_sum: float = 0.0
    ratio_max: float = 0.0
    side_max_px: float = 0.0
    within_a_pixel: int = 0

    def add(self, mesh_boxes_px: Array, shoebox_boxes_px: Array) -> None:
        """Add frames: two boxes each, shapes (n, 4)."""
        ratio = _areas(shoebox_boxes_px) / _areas(mesh_boxes_px)
        out = np.concatenate(
            [mesh_boxes_px[:, :2] - shoebox_boxes_px[:, :2], shoebox_boxes_px[:, 2:] - mesh_boxes_px[:, 2:]], axis=1
        ).max(axis=1)
        self.frames += len(ratio)
        self.ratio_sum += float(ratio.sum())
        self.ratio_max = max(self.ratio_max, float(ratio.max(initial=0.0)))
        self.side_max_px = max(self.side_max_px, float(out.max(initial=0.0)))
        self.within_a_pixel += int((out <= 1).sum())

    def figures(self) -> dict[str, Any]:
        """As plain values; the ratio says how many times larger the shoebox's box is."""
        return {
            "frames": self.frames,
            "mean_area_ratio": self.ratio_sum / max(self.frames, 1),
            "max_area_ratio": self.ratio_max,
            "max_side_px": self.side_max_px,
            "within_a_pixel": self.within_a_pixel,
        }


def _areas(boxes_px: Array) -> Array:
    areas: Array = sizes(boxes_px).prod(axis=1)
    return areas


def add_looseness(
    looseness: dict[str, Looseness], vessels: Sequence[Vessel], meshes: Outlines, shoeboxes: Outlines
) -> None:
    """Add the frames in which a vessel's mesh is in the image.

    Args:
        looseness: By vessel ID; grows.
        vessels: Of the scene.
        meshes: Rows of vessels as they are.
        shoeboxes: The same frames with all vessels as shoeboxes; a mesh lies inside its shoebox, so that each of its
            rows is there too.
    """
    keys = zip(shoeboxes.frame.tolist(), shoeboxes.occluder.tolist(), strict=True)
    place = {key: row for row, key in enumerate(keys)}
    for part in meshes.parts:
        for index in np.unique(meshes.occluder[part.rows]).tolist():
            if not vessels[index].has_mesh:
                continue
            rows = part.rows[meshes.occluder[part.rows] == index]
            others = [place[frame, index] for frame in meshes.frame[rows].tolist()]
            boxes = shoeboxes.boxes_px[others]
            looseness.setdefault(vessels[index].name, Looseness()).add(meshes.boxes_px[rows], boxes)
