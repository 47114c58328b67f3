"""How well a vessel's shoebox fits its mesh, as boxes in the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import areas
from modsim3d.truth.outlines import Outlines
from modsim3d.vessels.vessel import Vessel


@dataclass(frozen=True)
class ShoeboxFit:
    """One vessel's full boxes of mesh and shoebox, summed over frames. Fits of different frames add up.

    Attributes:
        frames: Number of frames in which the mesh is in the image.
        ratio_sum: Sum over frames of the area of the shoebox's box over the area of the mesh's box.
        ratio_max: The greatest of these ratios.
        side_max_px: The greatest distance by which a side of the shoebox's box is farther out.
        within_a_pixel: Number of frames in which no side is more than a pixel farther out.
    """

    frames: int
    ratio_sum: float
    ratio_max: float
    side_max_px: float
    within_a_pixel: int

    @classmethod
    def between(cls, mesh_boxes_px: Array, shoebox_boxes_px: Array) -> ShoeboxFit:
        """The fit over n frames.

        Args:
            mesh_boxes_px: Full box of the mesh in each frame, shape (n, 4).
            shoebox_boxes_px: Full box of the shoebox, shape (n, 4).
        """
        ratio = areas(shoebox_boxes_px) / areas(mesh_boxes_px)
        out = ((shoebox_boxes_px - mesh_boxes_px) * (-1, -1, 1, 1)).max(axis=1)
        return cls(
            frames=len(ratio),
            ratio_sum=float(ratio.sum()),
            ratio_max=float(ratio.max(initial=0.0)),
            side_max_px=float(out.max(initial=0.0)),
            within_a_pixel=int((out <= 1).sum()),
        )

    def __add__(self, other: ShoeboxFit) -> ShoeboxFit:
        """The fit over the frames of both."""
        return ShoeboxFit(
            self.frames + other.frames,
            self.ratio_sum + other.ratio_sum,
            max(self.ratio_max, other.ratio_max),
            max(self.side_max_px, other.side_max_px),
            self.within_a_pixel + other.within_a_pixel,
        )


def shoebox_fits(vessels: Sequence[Vessel], meshes: Outlines, shoeboxes: Outlines) -> dict[str, ShoeboxFit]:
    """The fit of each vessel with a mesh that is in an image.

    Args:
        vessels: Vessels of the scene.
        meshes: Rows of vessels with their own shapes.
        shoeboxes: The same frames with every vessel as its shoebox. A mesh lies inside its shoebox, so each of its rows
            is there too.

    Returns:
        Vessel ID → fit.
    """
    keys = zip(shoeboxes.frame.tolist(), shoeboxes.occluder.tolist(), strict=True)
    place = {key: row for row, key in enumerate(keys)}
    fits = {}
    for part in meshes.parts:
        for vessel in np.unique(meshes.occluder[part.rows]).tolist():
            if vessels[vessel].has_mesh:
                rows = part.rows[meshes.occluder[part.rows] == vessel]
                same = [place[frame, vessel] for frame in meshes.frame[rows].tolist()]
                fits[vessels[vessel].name] = ShoeboxFit.between(meshes.boxes_px[rows], shoeboxes.boxes_px[same])
    return fits
