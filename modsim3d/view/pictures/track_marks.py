"""Boxes of tracks, with their numbers and where their centres have been."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.runs.frames import Frame
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.palette import Colour
from modsim3d.view.pictures.canvas import Canvas
from modsim3d.view.pictures.labels import Label
from modsim3d.view.pictures.window import Window

WEIGHT = 2.5
"""Of a track's box, in weights of a line; a detection's has 1.5."""


@dataclass(frozen=True, eq=False)
class FrameTracks:
    """The tracks in one frame, m of them.

    Attributes:
        number: Numbers that the tracker gave them, shape (m,).
        boxes_px: x_min, y_min, x_max, y_max, shape (m, 4).
        false: Which follow nothing, shape (m,).
        unscored: Which follow a vessel that is hidden or not annotated, shape (m,).
        trails_px: Where the centre of each has been, the newest first, each of shape (n, 2).
    """

    number: Indices
    boxes_px: Array
    false: Mask
    unscored: Mask
    trails_px: tuple[Array, ...]

    @classmethod
    def of(cls, followed: FollowedTracks, scene: Scene, frame: Frame) -> Self:
        """The tracks in a frame of a scene."""
        camera = [each.name for each in scene.cameras].index(frame.camera)
        rows = followed.rows_of(frame.step * len(scene.cameras) + camera)
        return cls(
            followed.tracks.track[rows],
            followed.tracks.boxes_px[rows],
            followed.false[rows],
            followed.unscored[rows],
            tuple(followed.trail_px(row) for row in range(rows.start, rows.stop)),
        )


NO_TRACKS = FrameTracks(
    np.empty(0, dtype=np.int64), np.empty((0, 4)), np.empty(0, dtype=np.bool_), np.empty(0, dtype=np.bool_), ()
)


def track_colour(number: int, false: bool) -> Colour:
    """The colour of a track, by its number; that of what went wrong where it follows nothing."""
    return palette.ALARM if false else palette.track_colour(number)


def draw_tracks(canvas: Canvas, window: Window, tracks: FrameTracks) -> list[Label]:
    """Draw the tracks of a frame, and return their numbers as labels.

    A box is solid where its track follows a vessel that is to be followed, and dashed elsewhere.
    """
    labels = []
    numbers, dashed = tracks.number.tolist(), (tracks.false | tracks.unscored).tolist()
    for i, (number, false) in enumerate(zip(numbers, tracks.false.tolist(), strict=True)):
        colour, box = track_colour(number, false), window.corners(tracks.boxes_px[i])
        trail = window.to_picture(tracks.trails_px[i])
        canvas.segments(np.stack([trail[:-1], trail[1:]], axis=1), colour, 1.0)
        if dashed[i]:
            canvas.dashed_box(box, colour, WEIGHT)
        else:
            canvas.box(box, colour, WEIGHT, halo=True)
        labels.append(Label(box, f"#{number}", colour, below=True))
    return labels
