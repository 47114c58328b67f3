"""Paths that vessels follow: waypoints with rounded corners, displaced to a side, and places along them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.rotations import heading_of

MOST_POINTS = 20_000
POINTS_A_RADIUS = 30
"""Points on a stretch as long as the turning radius."""
SHARPEST_RAD = 2.6
"""Sharpest corner of a route (149°): the circle in a sharper one would lie far from it."""


@dataclass(frozen=True, eq=False)
class Path:
    """A smooth line as a dense polyline.

    Attributes:
        along_m: Distance from the start of each point, shape (K,).
        places_m: The points, shape (K, 2).
        headings_rad: Tangents at the points, without jumps of a turn, shape (K,).
    """

    along_m: Array
    places_m: Array
    headings_rad: Array

    @classmethod
    def through(cls, places_m: Array) -> Path:
        """The path through dense points, shape (K, 2)."""
        steps = np.diff(places_m, axis=0)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
        return cls(along, places_m, np.unwrap(heading_of(np.gradient(places_m, axis=0))))

    @property
    def length_m(self) -> float:
        """Length from start to end."""
        return float(self.along_m[-1])

    def at(self, along_m: Array) -> tuple[Array, Array]:
        """Places, shape (..., 2), and headings at distances from the start; straight on beyond both ends."""
        inside = np.clip(along_m, 0.0, self.length_m)
        place = np.stack([np.interp(inside, self.along_m, self.places_m[:, i]) for i in (0, 1)], axis=-1)
        heading = np.interp(inside, self.along_m, self.headings_rad)
        beyond = (along_m - inside)[..., None]
        return place + beyond * np.stack([np.cos(heading), np.sin(heading)], axis=-1), heading

    def displaced(self, to_port_m: Array | float) -> Path:
        """The path at a distance to port, a number or one for each point, shape (K,)."""
        normal = np.stack([-np.sin(self.headings_rad), np.cos(self.headings_rad)], axis=-1)
        return Path.through(self.places_m + normal * np.broadcast_to(to_port_m, self.along_m.shape)[:, None])

    def trimmed(self, margin_m: float) -> Path:
        """The path without a piece at either end; together they are shorter than the path."""
        ends = np.array([margin_m, self.length_m - margin_m])
        inside = (self.along_m > ends[0]) & (self.along_m < ends[1])
        (first, last), turned = self.at(ends)
        headings = np.concatenate([turned[:1], self.headings_rad[inside], turned[1:]])
        along = np.concatenate([[0.0], self.along_m[inside] - margin_m, [ends[1] - margin_m]])
        return Path(along, np.concatenate([first[None], self.places_m[inside], last[None]]), headings)

    def reversed(self) -> Path:
        """The same line from its end to its start."""
        return Path(self.length_m - self.along_m[::-1], self.places_m[::-1], self.headings_rad[::-1] + math.pi)


def rounded(waypoints_m: Array, radius_m: float) -> Path:
    """The path through waypoints whose corners are circles of a radius, or of what their legs leave room for.

    The circle begins and ends gradually: its curvature rises over half a radius, as a ship's rate of turn does.

    Args:
        waypoints_m: At least two places that differ, shape (k, 2).
        radius_m: Radius of the turns.
    """
    legs = np.diff(waypoints_m, axis=0)
    length = np.hypot(legs[:, 0], legs[:, 1])
    along = legs / length[:, None]
    pieces = [waypoints_m[:1]]
    for corner, radius in enumerate(corner_radii_m(waypoints_m, radius_m), start=1):
        pieces.append(_arc(waypoints_m[corner], along[corner - 1], along[corner], float(radius)))
    return _evenly(np.concatenate([*pieces, waypoints_m[-1:]]), radius_m)


def turns_rad(waypoints_m: Array) -> Array:
    """Changes of course at the inner waypoints, to port positive, shape (k − 2,)."""
    legs = np.diff(waypoints_m, axis=0)
    cross = legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    turns: Array = np.arctan2(cross, (legs[:-1] * legs[1:]).sum(axis=1))
    return turns


def corner_radii_m(waypoints_m: Array, wanted_m: float) -> Array:
    """Radii of the circles in the corners, shape (k − 2,): as wanted, or as large as the legs leave room for."""
    legs = np.diff(waypoints_m, axis=0)
    length = np.hypot(legs[:, 0], legs[:, 1])
    room = np.full(len(length), 0.5)
    room[[0, -1]] = 1.0  # the first and the last leg have a corner at one end
    free = length * room
    tangent = np.tan(np.abs(turns_rad(waypoints_m)) / 2)
    most = np.minimum(free[:-1], free[1:]) / np.maximum(tangent, 1e-9)
    radii: Array = np.minimum(most, wanted_m)
    return radii


def _arc(corner: Array, before: Array, after: Array, radius_m: float) -> Array:
    """Points of a circle that touches both legs, directions of shape (2,); the corner itself if it hardly turns."""
    turn = math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))
    if abs(turn) < 1e-4:
        return corner[None]
    tangent = radius_m * math.tan(abs(turn) / 2)
    side = math.copysign(1.0, turn)
    start, inward = corner - tangent * before, side * np.array([-before[1], before[0]])
    angles = np.linspace(0.0, abs(turn), max(3, math.ceil(abs(turn) * POINTS_A_RADIUS)))[:, None]
    return start + radius_m * (np.sin(angles) * before + (1 - np.cos(angles)) * inward)


def _evenly(line: Array, radius_m: float) -> Path:
    """Points at even distances on a line of straight pieces and arcs, smoothed over half a radius."""
    steps = np.diff(line, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    total = float(along[-1])
    spacing = max(radius_m / POINTS_A_RADIUS, total / MOST_POINTS)
    count = max(math.ceil(total / spacing), 8) + 1
    even = np.linspace(0.0, total, count)
    places = np.stack([np.interp(even, along, line[:, i]) for i in (0, 1)], axis=-1)
    half = min(POINTS_A_RADIUS // 4, (count - 1) // 4)
    return Path.through(_running_mean(places, half))


def _running_mean(places: Array, half: int) -> Array:
    """Mean of each point and `half` points on either side; the line goes on straight beyond its ends."""
    ahead = np.arange(1, half + 1)[:, None]
    start = places[0] - ahead[::-1] * (places[1] - places[0])
    end = places[-1] + ahead * (places[-1] - places[-2])
    total = np.cumsum(np.concatenate([np.zeros((1, 2)), start, places, end]), axis=0)
    width = 2 * half + 1
    mean: Array = (total[width:] - total[:-width]) / width
    return mean
