"""Horizons and silhouettes of a run's frames: what its page shows and its tables do not hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.run_rows import RunRows
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.triangles import triangles_of
from modsim3d.view.report.contours import contours, one_way_round
from modsim3d.view.report.painting_order import in_front, painting_order

NONE = 0xFFFF
"""A box side, a vessel or an occluder that is not there; every place in an image is below it."""
STEPS_TOGETHER = 250
"""Steps whose geometry is computed together: few calls, little memory."""
MOST_FACES = 300_000
"""Number of faces whose outlines are computed together: few calls, little memory."""


def silhouette_columns(
    rows: RunRows, taken: Indices, frames: Indices, quantum_px: float, progress: Callable[[int], None]
) -> tuple[Array, Indices, dict[str, NDArray[Any]]]:
    """The horizons and silhouettes of a run's frames, for its player.

    A silhouette refers to an outline, so that what stands still before a camera ashore is stored once.

    Args:
        rows: The run.
        taken: Step of the frame that each camera shows at each shown step, shape (steps, cameras).
        frames: Numbers of those frames, ascending, shape (F,).
        quantum_px: The unit of lengths in the image.
        progress: Called with the number of steps done since its last call.

    Returns:
        Sea half plane of each frame, shape (F, 3); index of the frame of each silhouette, ascending, shape (s,); and
        the columns `owner` and `outline` of the silhouettes, shape (s,), `lineCount` of the outlines, `cornerCount` of
        their lines, and `corners` of the lines: column and row by turns, in quanta.
    """
    scene, cameras, occluder_count = rows.scene, len(rows.scene.cameras), len(rows.scene.occluder_names)
    horizons, hides = np.empty((len(frames), 3)), _hides(rows, occluder_count)
    outlines: dict[tuple[bytes, bytes], int] = {}
    found: list[tuple[int, int, int]] = []
    for index, steps in _once_each(taken, progress):
        camera, numbers = scene.cameras[index], steps * cameras + index
        sight = scene.sight(camera, steps)
        horizons[np.searchsorted(frames, numbers)] = camera.intrinsics.sea_half_plane(sight.camera_poses.camera_R_world)
        before = sight.outlines()
        numbered = replace(before, frame=numbers[before.frame])
        for shape in shapes(numbered, camera.intrinsics, quantum_px, occluder_count, hides):
            key = shape.count.tobytes(), shape.corners.tobytes()
            found.append((shape.frame, shape.occluder, outlines.setdefault(key, len(outlines))))
    table = np.array(found, dtype=np.int64).reshape(-1, 3)
    number, occluder, outline = table[np.argsort(table[:, 0], kind="stable")].T
    columns: dict[str, NDArray[Any]] = {
        "owner": occluder.astype(np.uint16),
        "outline": outline.astype(np.uint32),
        "lineCount": np.array([len(count) // 4 for count, _ in outlines], dtype=np.uint32),
        "cornerCount": np.frombuffer(b"".join(count for count, _ in outlines), np.uint32),
        "corners": np.frombuffer(b"".join(corners for _, corners in outlines), np.uint16),
    }
    return horizons, np.searchsorted(frames, number), columns


def _once_each(taken: Indices, progress: Callable[[int], None]) -> Iterator[tuple[int, Indices]]:
    """Cameras and steps of their frames, some at a time; a frame that is shown at several steps comes once."""
    done = [NOBODY] * taken.shape[1]
    for first in range(0, len(taken), STEPS_TOGETHER):
        some = taken[first : first + STEPS_TOGETHER]
        for camera, column in enumerate(some.T):
            steps = np.unique(column[column > done[camera]])
            if len(steps):
                done[camera] = int(steps[-1])
                yield camera, steps
        progress(len(some))


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
