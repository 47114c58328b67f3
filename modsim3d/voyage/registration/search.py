"""The first guess: which clock and which turn of the camera explain most detections.

Every pair of a detection and a vessel in one frame votes for the turn that would put the vessel there, in a histogram
over turns to the side and up or down, once for each offset of the clock. Pairs that belong together vote for one cell;
all others are spread. How many votes a cell gets by chance is counted on the mirrored detections, which no camera at
this place could have made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.camera import Intrinsics
from modsim3d.voyage.registration.boxes_at_times import BoxesAtTimes
from modsim3d.voyage.registration.model import BoxModel
from modsim3d.voyage.registration.parameters import Values

CELL_RAD = np.radians(0.5)
MOST_DOWN_RAD = np.radians(4.0)
SIZE_RATIO = 2.5
SEARCHED_FRAMES = 150
APART_S = 2.0


@dataclass(frozen=True)
class Guess:
    """A clock and a turn, and how many detections vote for them.

    Attributes:
        clock_s: Seconds to add to the detector's times.
        yaw_deg: Turn of the camera to port.
        pitch_deg: Turn down.
        votes: Detections of the searched frames that they explain.
    """

    clock_s: float
    yaw_deg: float
    pitch_deg: float
    votes: int

    def values(self, vessels: int) -> Values:
        """As a start of a fit."""
        return Values.none(vessels).changed(clock_s=self.clock_s, yaw_deg=self.yaw_deg, pitch_deg=self.pitch_deg)


@dataclass(frozen=True, eq=False)
class Search:
    """Guesses, best first, and what chance would have given.

    Attributes:
        guesses: At most one every `APART_S` seconds of the clock.
        chance: Votes of the best cell for mirrored detections.
        searched: Number of detections that could vote.
    """

    guesses: tuple[Guess, ...]
    chance: int
    searched: int


@dataclass(frozen=True, eq=False)
class _Seen:
    """Detections as directions from the camera: azimuth to the right, elevation down, width, all in radians."""

    frame: Indices
    azimuth: Array
    down: Array
    width: Array


def search(model: BoxModel, found: BoxesAtTimes, clocks_s: Array, most_turn_rad: float, most: int = 6) -> Search:
    """Vote over clocks, shape (c,), and turns to the side of at most so much.

    Args:
        model: The vessels before the camera.
        found: The detections.
        clocks_s: Offsets of the clock to try, ascending.
        most_turn_rad: π for all directions around.
        most: Number of guesses.
    """
    some = found.some(SEARCHED_FRAMES)
    lens = model.traffic.camera.intrinsics
    seen, mirrored = _directions(lens, some), _directions(lens, _mirrored(lens, some))
    tables = [_tables(model, some.times_s + clock, most_turn_rad) for clock in clocks_s]
    votes = [_votes(seen, table, most_turn_rad) for table in tables]
    chance = max((_votes(mirrored, table, most_turn_rad)[0] for table in tables), default=0)
    order = sorted(range(len(clocks_s)), key=lambda i: -votes[i][0])
    kept: list[int] = []
    for index in order:
        if all(abs(clocks_s[index] - clocks_s[other]) >= APART_S for other in kept) and votes[index][0]:
            kept.append(index)
    guesses = tuple(
        Guess(float(clocks_s[i]), float(np.degrees(votes[i][1])), float(-np.degrees(votes[i][2])), votes[i][0])
        for i in kept[:most]
    )
    return Search(guesses, chance, len(seen.frame))


def _mirrored(lens: Intrinsics, found: BoxesAtTimes) -> BoxesAtTimes:
    boxes = found.boxes_px[:, [2, 1, 0, 3]] * (-1, 1, -1, 1) + np.array([lens.image_size_px[0], 0] * 2)
    return BoxesAtTimes(found.times_s, found.frame, boxes)


def _directions(lens: Intrinsics, found: BoxesAtTimes) -> _Seen:
    """The middle of the lower edge of each box, and the angle between its sides; what no lens shows is left out."""
    left, _, right, bottom = found.boxes_px.T
    pixels = np.stack([np.stack([x, bottom], axis=-1) for x in (left, (left + right) / 2, right)], axis=1)
    rays = lens.unproject(pixels, np.ones(pixels.shape[:2]))
    azimuth = np.arctan2(rays[..., 0], rays[..., 2])
    down = np.arctan2(rays[:, 1, 1], np.hypot(rays[:, 1, 0], rays[:, 1, 2]))
    known = np.isfinite(azimuth).all(axis=1) & np.isfinite(down)
    width = azimuth[:, 2] - azimuth[:, 0]
    return _Seen(found.frame[known], azimuth[known, 1], down[known], width[known])


def _tables(model: BoxModel, times_s: Array, most_turn_rad: float) -> _Seen:
    """The same of all vessels that are there and, turned by the most, in the field of view, in order of frame."""
    traffic, count = model.traffic, len(model.hulls_m)
    frame, vessel = np.divmod(np.arange(len(times_s) * count), count)
    there = traffic.there(times_s[frame], vessel)
    if traffic.carrier is not None:
        there &= vessel != traffic.carrier
        there &= traffic.there(times_s[frame], np.full(len(frame), traffic.carrier))
    frame, vessel = frame[there], vessel[there]
    if not len(frame):
        return _Seen(frame, *np.empty((3, 0)))
    none = Values.none(count)
    places, rotations = traffic.at(times_s[frame], vessel)
    camera = model.camera_poses(none, times_s[frame]).to_camera(places[:, None])[:, 0]
    away = np.maximum(np.hypot(camera[:, 0], camera[:, 2]), 1.0)
    to_camera = model.camera_poses(none, times_s[frame]).positions_m - places
    bearing = np.einsum("nij,ni->nj", rotations, to_camera)[:, :2] / away[:, None]
    length, beam = np.ptp(model.hulls_m[vessel], axis=1)[:, :2].T
    width = (length * np.abs(bearing[:, 1]) + beam * np.abs(bearing[:, 0])) / away
    azimuth, down = np.arctan2(camera[:, 0], camera[:, 2]), np.arctan2(camera[:, 1], away)
    lens = traffic.camera.intrinsics
    half = np.arctan(lens.image_size_px[0] / 2 / lens.focal_px[0]) + most_turn_rad
    seen = np.abs(azimuth) < half + width
    return _Seen(frame[seen], azimuth[seen], down[seen], width[seen])


def _votes(seen: _Seen, vessels: _Seen, most_turn_rad: float) -> tuple[int, float, float]:
    """Votes of the best cell and its turn to the side and down, in radians."""
    start, stop = (np.searchsorted(vessels.frame, seen.frame, side=side) for side in ("left", "right"))
    count = stop - start
    box = np.repeat(np.arange(len(seen.frame)), count)
    row = np.repeat(start - (np.cumsum(count) - count), count) + np.arange(len(box))
    side = np.remainder(seen.azimuth[box] - vessels.azimuth[row] + np.pi, 2 * np.pi) - np.pi
    down = seen.down[box] - vessels.down[row]
    ratio = np.abs(np.log(np.maximum(seen.width[box], 1e-6) / np.maximum(vessels.width[row], 1e-6)))
    kept = (np.abs(side) < most_turn_rad) & (np.abs(down) < MOST_DOWN_RAD) & (ratio < np.log(SIZE_RATIO))
    side, down, box = side[kept], down[kept], box[kept]
    if not len(side):
        return 0, 0.0, 0.0
    columns, rows = (int(2 * most // CELL_RAD) + 3 for most in (most_turn_rad, MOST_DOWN_RAD))
    column = ((side + most_turn_rad) // CELL_RAD).astype(int) + 1
    level = ((down + MOST_DOWN_RAD) // CELL_RAD).astype(int) + 1
    cells = np.bincount(column * rows + level, minlength=columns * rows)[: columns * rows].reshape(columns, rows)
    around = np.pad(cells, 1)
    smooth = np.sum([around[i : i + columns, j : j + rows] for i in range(3) for j in range(3)], axis=0)
    best = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    near = (np.abs(column - best[0]) <= 1) & (np.abs(level - best[1]) <= 1)
    return len(np.unique(box[near])), float(np.median(side[near])), float(np.median(down[near]))
