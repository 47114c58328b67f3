"""Horizons and silhouettes of a run's frames: what its page shows and its tables do not hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.triangles import triangles_of
from modsim3d.view.report.contours import contours, one_way_round
from modsim3d.view.report.packing import NONE, OUTLINE_BEFORE, ROW_BEFORE, Coded, Column
from modsim3d.view.report.painting_order import in_front, painting_order

STILL = 1 << 31
"""The first number of the outlines that all parts share."""
STEPS_TOGETHER = 250
"""Steps whose geometry is computed together: few calls, little memory."""
MOST_FACES = 300_000
"""Number of faces whose outlines are computed together: few calls, little memory."""


class Silhouettes:
    """The horizons and silhouettes of a run that comes in parts.

    A silhouette refers to an outline, so that what stands still is stored once: what an obstacle shows to a camera ashore
    once for all parts, the rest once in each part.
    """

    def __init__(self, scene: Scene, quantum_px: float) -> None:
        """Begin with no part of a run of a scene; lengths in the image are in this unit."""
        self._scene, self._quantum_px = scene, quantum_px
        self._still = _OutlineStore()

    def columns(
        self, rows: RunRows, frames: Sequence[Indices], horizons: Array
    ) -> tuple[Indices, dict[str, Column | Coded]]:
        """The silhouettes of one part, and its horizons.

        Args:
            rows: The run's rows of these frames at least.
            frames: For each camera the steps of its frames, ascending, shape (F_c,).
            horizons: Receives the sea half plane of each frame, camera by camera, shape (F, 3) with F = ΣF_c at least.

        Returns:
            Number of the frame of each silhouette, counted camera by camera, ascending, shape (s,); and the columns
            `owner` and `outline` of the silhouettes, shape (s,), `lineCount` of the outlines, `cornerCount` of their
            lines, and `corners` of the lines: column and row, in quanta, shape (k, 2).
        """
        scene, occluder_count = self._scene, len(self._scene.occluder_names)
        moving, hides = _OutlineStore(), _hides(rows, occluder_count)
        found: list[tuple[int, int, int]] = []
        begin = 0
        for index, every in enumerate(frames):
            camera = scene.cameras[index]
            still_owner = len(scene.vessels) if camera.mount.vessel is None else occluder_count
            for first in range(0, len(every), STEPS_TOGETHER):
                steps = every[first : first + STEPS_TOGETHER]
                sight, place = scene.sight(camera, steps), begin + first
                half_planes = camera.intrinsics.sea_half_plane(sight.camera_poses.camera_R_world)
                horizons[place : place + len(steps)] = half_planes
                before = sight.outlines()
                numbered = replace(before, frame=(steps * len(scene.cameras) + index)[before.frame])
                for shape in shapes(numbered, camera.intrinsics, self._quantum_px, occluder_count, hides):
                    store = self._still if shape.occluder >= still_owner else moving
                    number = store.number(shape) + (STILL if store is self._still else 0)
                    at = place + int(np.searchsorted(steps, shape.frame // len(scene.cameras)))
                    found.append((at, shape.occluder, number))
            begin += len(every)
        table = np.array(found, dtype=np.int64).reshape(-1, 3)
        frame, owner, outline = table[np.argsort(table[:, 0], kind="stable")].T
        return frame, {
            "owner": Coded(owner.astype(np.uint16), by=ROW_BEFORE),
            "outline": Coded(outline.astype(np.uint32), by="owner"),
            **moving.columns(),
        }

    def still_columns(self) -> dict[str, Column | Coded]:
        """The outlines that all parts refer to, numbered from `STILL` on."""
        return self._still.columns()


class _OutlineStore:
    """Different outlines, numbered in the order in which they come."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[bytes, bytes], int] = {}
        self._owners: list[int] = []

    def number(self, shape: Shape) -> int:
        """The number of a shape's outline, a new one if no other has the same lines."""
        number = self._numbers.setdefault((shape.count.tobytes(), shape.corners.tobytes()), len(self._owners))
        if number == len(self._owners):
            self._owners.append(shape.occluder)
        return number

    def columns(self) -> dict[str, Column | Coded]:
        """Their owners, the numbers of their lines and of the lines' corners, and the corners."""
        lines = np.array([len(count) // 4 for count, _ in self._numbers], dtype=np.uint32)
        corners = np.frombuffer(b"".join(corners for _, corners in self._numbers), np.uint16)
        counts = np.frombuffer(b"".join(count for count, _ in self._numbers), np.uint32)
        return {
            "outlineOwner": Coded(np.array(self._owners, dtype=np.uint16), by=ROW_BEFORE),
            "lineCount": Coded(lines, by="outlineOwner"),
            "cornerCount": Coded(counts, by=ROW_BEFORE),
            "corners": Coded(corners.reshape(-1, 2), by=OUTLINE_BEFORE),
        }


def _hides(rows: RunRows, occluder_count: int) -> Indices:
    """Keys of what hides what in the truth, see `in_front`, shape (m,)."""
    occluders = rows.occluders()
    frame, hidden = rows.truth_frame[occluders.hidden], rows.truth_vessel[occluders.hidden]
    keys: Indices = (frame * occluder_count + hidden) * occluder_count + occluders.name
    return keys


@dataclass(frozen=True, eq=False)
class Shape:
    """A silhouette, or the pieces of an obstacle between which nothing else is painted, as l closed lines.

    Their corners follow line after line in quanta, shape (k, 2); `count` is the number of each line's, shape (l,).
    """

    frame: int
    occluder: int
    corners: NDArray[np.uint16]
    count: NDArray[np.uint32]


def shapes(
    outlines: Outlines, intrinsics: Intrinsics, quantum_px: float, occluder_count: int, hides: Indices
) -> Iterator[Shape]:
    """The silhouettes of all frames of a camera, frame by frame and from back to front.

    Args:
        outlines: The solids before the camera.
        intrinsics: The camera's intrinsics.
        quantum_px: The unit of lengths in the image.
        occluder_count: Number of the scene's occluder names.
        hides: Keys of what hides what in the truth, see `in_front`, shape (m,).
    """
    hidden, hider = in_front(outlines, occluder_count, hides)
    order = painting_order(outlines.frame, outlines.depth_m, outlines.occluder, hidden, hider)
    frame, occluder = outlines.frame[order], outlines.occluder[order]
    begins = np.flatnonzero((np.diff(frame, prepend=-1) != 0) | (np.diff(occluder, prepend=-1) != 0))
    shape_of_row = np.empty(len(order), dtype=np.int64)
    shape_of_row[order] = np.searchsorted(begins, np.arange(len(order)), side="right") - 1
    for rows in _in_turns(outlines):
        some = outlines.take(rows)
        triangles = triangles_of(some, intrinsics, guard_px=0.0)
        corners = np.clip(np.rint(triangles.corners_px / quantum_px), 0, NONE - 1).astype(np.int64)
        kept, corners = one_way_round(triangles.corners_px, corners, _closed(some)[triangles.row])
        found = contours(shape_of_row[rows[triangles.row[kept]]], corners)
        first_line = np.flatnonzero(np.diff(found.shape, prepend=-1))
        first_corner = (np.cumsum(found.count) - found.count)[first_line]
        pieces = np.split(found.corners.astype(np.uint16), first_corner)[1:]
        counts = np.split(found.count.astype(np.uint32), first_line)[1:]
        for begin, piece, count in zip(begins[found.shape[first_line]].tolist(), pieces, counts, strict=True):
            yield Shape(int(frame[begin]), int(occluder[begin]), piece, count)


def _in_turns(outlines: Outlines) -> list[Indices]:
    """Rows of whole frames, so that their faces fit into memory."""
    if not len(outlines):
        return []
    faces = np.zeros(len(outlines))
    for part in outlines.parts:
        faces[part.rows] = len(part.solid.faces)
    _, frame = np.unique(outlines.frame, return_inverse=True)
    turn = np.cumsum(np.bincount(frame, faces)) // MOST_FACES
    return np.split(np.arange(len(outlines)), np.flatnonzero(np.diff(turn[frame])) + 1)


def _closed(outlines: Outlines) -> Mask:
    """Whether the solid of each row is closed, shape (n,)."""
    closed = np.zeros(len(outlines), dtype=bool)
    for part in outlines.parts:
        closed[part.rows] = part.solid.closed
    return closed
