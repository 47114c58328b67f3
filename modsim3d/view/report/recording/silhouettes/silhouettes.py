"""Horizons and silhouettes of a run's frames: what its page shows and its tables do not hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.motion.vessel_motion import PosesInWaves
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.truth.outlines import Outlines, new_numbers
from modsim3d.view.report.recording.packing import NONE, OUTLINE_BEFORE, ROW_BEFORE, Coded, Column, same_before
from modsim3d.view.report.recording.part_motion import PartMotion
from modsim3d.view.report.recording.silhouettes.contours import contours, tidy_at_border
from modsim3d.view.report.recording.silhouettes.painting_order import in_front, painting_order
from modsim3d.view.report.recording.silhouettes.shapes import NO_SHAPES, Shapes, concatenated
from modsim3d.view.report.recording.silhouettes.silhouette_edges import Edges, silhouette_edges

STILL = 1 << 31
"""The first number of the outlines that all parts share."""
STEPS_TOGETHER = 250
"""Steps whose geometry is computed together: few calls, little memory."""


class Silhouettes:
    """The horizons and silhouettes of a run that comes in parts.

    A silhouette refers to an outline, so that what stands still is stored once: what an obstacle shows to a camera
    ashore once for all parts, the rest once in each part.
    """

    def __init__(self, scene: Scene, quantum_px: float) -> None:
        """Begin with no part of a run of a scene; lengths in the image are in this unit."""
        self._scene, self._quantum_px = scene, quantum_px
        self._still = OutlineStore()

    def columns(
        self, rows: RunRows, frames: Sequence[Indices], motion: PartMotion, horizons: Array
    ) -> tuple[Indices, dict[str, Column | Coded]]:
        """The silhouettes of one part, and its horizons.

        Args:
            rows: The run's rows of these frames at least.
            frames: For each camera the steps of its frames, ascending, shape (F_c,).
            motion: The vessels at these steps.
            horizons: Receives the sea half plane of each frame, camera by camera, shape (F, 3) with F = ΣF_c at least.

        Returns:
            Number of the frame of each silhouette, counted camera by camera, ascending, shape (s,); and the columns
            `owner` and `outline` of the silhouettes, shape (s,), `lineCount` of the outlines, `cornerCount` of their
            lines, and `corners` of the lines: column and row, in quanta, shape (k, 2).
        """
        scene, occluder_count = self._scene, len(self._scene.occluder_names)
        hides = hiding(rows)
        found: list[Shapes] = [NO_SHAPES]
        still, begin = [np.empty(0, dtype=bool)], 0
        for index, every in enumerate(frames):
            camera = scene.cameras[index]
            still_owner = len(scene.vessels) if camera.mount.vessel is None else occluder_count
            for first in range(0, len(every), STEPS_TOGETHER):
                steps = every[first : first + STEPS_TOGETHER]
                place = begin + first
                horizons[place : place + len(steps)], drawn = seen(
                    scene, index, steps, motion.at(steps), self._quantum_px, hides
                )
                found.append(replace(drawn, frame=place + drawn.frame))
                still.append(drawn.occluder >= still_owner)
            begin += len(every)
        every_shape, stands = concatenated(found), np.concatenate(still)
        outline = np.empty(len(stands), dtype=np.int64)
        outline[stands] = STILL + self._still.numbers(every_shape.take(stands))
        moving = every_shape.take(~stands)
        outline[~stands], new = outline_numbers(moving, _camera_of(moving.frame, frames))
        order = np.argsort(every_shape.frame, kind="stable")
        return every_shape.frame[order], {
            "owner": Coded(every_shape.occluder[order].astype(np.uint16), by=ROW_BEFORE),
            "outline": Coded(outline[order].astype(np.uint32), by="owner"),
            **_outline_columns(moving.take(new)),
        }

    def still_columns(self) -> dict[str, Column | Coded]:
        """The outlines that all parts refer to, numbered from `STILL` on."""
        return _outline_columns(self._still.shapes())


def seen(
    scene: Scene, index: int, steps: Indices, motion: PosesInWaves, quantum_px: float, hides: Indices
) -> tuple[Array, Shapes]:
    """What a camera sees at some steps.

    Args:
        scene: The scene.
        index: Index of the camera.
        steps: Ascending steps at which it takes a frame, shape (S,).
        motion: Poses of all vessels at these steps.
        quantum_px: The unit of lengths in the image.
        hides: Keys of what hides what in the truth, from `hiding`, shape (m,).

    Returns:
        The sea half plane at each step, shape (S, 3); the silhouettes from back to front, with the place of their step
        as their frame.
    """
    camera = scene.cameras[index]
    sight, numbers = scene.sight(camera, steps, motion), steps * len(scene.cameras) + index
    half_planes = camera.intrinsics.sea_half_plane(sight.camera_poses.camera_R_world)
    before = sight.outlines(measured=False)
    numbered = replace(before, frame=numbers[before.frame])
    drawn = shapes(numbered, camera.intrinsics, quantum_px, len(scene.occluder_names), hides)
    return half_planes, replace(drawn, frame=np.searchsorted(numbers, drawn.frame))


def _camera_of(frame: Indices, frames: Sequence[Indices]) -> Indices:
    """The camera of each frame, whose numbers are counted camera by camera, shape (n,)."""
    camera: Indices = np.searchsorted(np.cumsum([len(every) for every in frames]), frame, side="right")
    return camera


def outline_numbers(moving: Shapes, camera: Indices) -> tuple[Indices, Mask]:
    """The outline of each shape, and which shapes are the first of theirs, both of shape (s,).

    A shape has the outline of the shape before of its occluder in its camera if that is the same.
    """
    before = same_before(moving.occluder * (int(camera.max(initial=0)) + 1) + camera)
    new = ~moving.equal(before)
    number = np.cumsum(new) - 1
    while len(repeated := np.flatnonzero(~new & (number != number[before]))):
        number[repeated] = number[before[repeated]]
    return number, new


class OutlineStore:
    """Different outlines, numbered in the order in which they come."""

    def __init__(self) -> None:
        """Begin with none."""
        self._numbers: dict[tuple[bytes, bytes], int] = {}
        self._kept: list[Shapes] = [NO_SHAPES]

    def numbers(self, some: Shapes) -> Indices:
        """The number of each shape's outline, shape (s,), a new one if no other has the same lines."""
        found, new = np.empty(len(some), dtype=np.int64), np.zeros(len(some), dtype=bool)
        for place, (count, corners) in enumerate(some.pieces()):
            new[place] = (key := (count.tobytes(), corners.tobytes())) not in self._numbers
            found[place] = self._numbers.setdefault(key, len(self._numbers))
        self._kept.append(some.take(new))
        return found

    def shapes(self) -> Shapes:
        """A shape with each of them."""
        return concatenated(self._kept)


def _outline_columns(different: Shapes) -> dict[str, Column | Coded]:
    """The owners of outlines, the numbers of their lines and of the lines' corners, and the corners."""
    return {
        "outlineOwner": Coded(different.occluder.astype(np.uint16), by=ROW_BEFORE),
        "lineCount": Coded(different.lines.astype(np.uint32), by="outlineOwner"),
        "cornerCount": Coded(different.count.astype(np.uint32), by=ROW_BEFORE),
        "corners": Coded(different.corners, by=OUTLINE_BEFORE),
    }


def hiding(rows: RunRows) -> Indices:
    """Keys of what hides what in the truth, see `in_front`, shape (m,)."""
    occluders, occluder_count = rows.occluders(), len(rows.scene.occluder_names)
    frame, hidden = rows.truth_frame[occluders.hidden], rows.truth_vessel[occluders.hidden]
    keys: Indices = (frame * occluder_count + hidden) * occluder_count + occluders.name
    return keys


def shapes(
    outlines: Outlines, intrinsics: Intrinsics, quantum_px: float, occluder_count: int, hides: Indices
) -> Shapes:
    """The silhouettes of all frames of a camera, frame by frame and from back to front.

    Args:
        outlines: The solids before the camera.
        intrinsics: The camera's intrinsics.
        quantum_px: The unit of lengths in the image.
        occluder_count: Number of the scene's occluder names.
        hides: Keys of what hides what in the truth, see `in_front`, shape (m,).
    """
    edges = silhouette_edges(outlines, intrinsics)
    outlines, edges = _seen(outlines, edges)
    hidden, hider = in_front(outlines, occluder_count, hides)
    order = painting_order(outlines.frame, outlines.depth_m, outlines.occluder, hidden, hider)
    frame, occluder = outlines.frame[order], outlines.occluder[order]
    begins = np.flatnonzero((np.diff(frame, prepend=-1) != 0) | (np.diff(occluder, prepend=-1) != 0))
    shape_of_row = np.empty(len(order), dtype=np.int64)
    shape_of_row[order] = np.searchsorted(begins, np.arange(len(order)), side="right") - 1
    places = np.clip(np.rint(edges.ends_px / quantum_px), 0, NONE - 1).astype(np.int64)
    stays = np.all(places[:, 0] == places[:, 1], axis=1)
    row_of, places = edges.row[~stays], places[~stays]
    column, row = np.rint(np.array(intrinsics.image_size_px) / quantum_px).astype(np.int64).tolist()
    found = contours(*tidy_at_border(shape_of_row[row_of], places, (column, row)))
    first_line = np.flatnonzero(np.diff(found.shape, prepend=-1))
    begin = begins[found.shape[first_line]]
    lines = np.diff(first_line, append=len(found.shape))
    return Shapes(frame[begin], occluder[begin], lines, found.count, found.corners.astype(np.uint16))


def _seen(outlines: Outlines, edges: Edges) -> tuple[Outlines, Edges]:
    """The outlines that have edges in the image, with the boxes of these, and the edges."""
    rows = edges.row[np.flatnonzero(np.diff(edges.row, prepend=-1))]
    boxes_px = edges.boxes_px(len(outlines))[rows]
    numbered = replace(edges, row=new_numbers(rows, len(outlines))[edges.row])
    return replace(outlines.take(rows), boxes_px=boxes_px), numbered
