"""Least distance of two hulls over a drive, between its times too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Mask
from modsim3d.geometry.kinematics import HullTracks

TOLERANCE_M = 0.01
"""The least distance of hulls is at most this much too large."""
_CORNERS = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
_MAX_HALVINGS = 40


@dataclass(frozen=True, eq=False)
class Rectangles:
    """n rectangles: centres (n, 2), directions of their lengths (n,), half lengths and half beams (n, 2)."""

    centres_m: Array
    headings_rad: Array
    half_sizes_m: Array


def rectangle_distances(ones: Rectangles, others: Rectangles) -> Array:
    """Distances of n pairs of rectangles in metres, 0 where they touch or overlap, shape (n,)."""
    # Of two rectangles that are apart, a corner of one is among the nearest points.
    of_others, of_ones = _corners(others, ones), _corners(ones, others)
    outside = np.minimum(_least_outside(of_others, ones.half_sizes_m), _least_outside(of_ones, others.half_sizes_m))
    overlap = _straddles(of_others, ones.half_sizes_m) & _straddles(of_ones, others.half_sizes_m)
    distances: Array = np.where(overlap, 0.0, outside)
    return distances


def _corners(rectangles: Rectangles, seen_from: Rectangles) -> Array:
    """Corners of rectangles along the length and across of others, shape (n, 4, 2)."""
    local = _turned(_CORNERS * rectangles.half_sizes_m[:, None], rectangles.headings_rad)
    offset = (rectangles.centres_m - seen_from.centres_m)[:, None]
    return _turned(local + offset, -seen_from.headings_rad)


def _turned(places_m: Array, angles_rad: Array) -> Array:
    """Places of shape (n, 4, 2), turned counter-clockwise by angles of shape (n,)."""
    cos, sin = np.cos(angles_rad)[:, None], np.sin(angles_rad)[:, None]
    x, y = places_m[..., 0], places_m[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _least_outside(corners: Array, half_m: Array) -> Array:
    """Least distance of any of the four corners from the rectangle, shape (n,)."""
    beyond = np.maximum(np.abs(corners) - half_m[:, None], 0.0)
    least: Array = np.hypot(beyond[..., 0], beyond[..., 1]).min(axis=1)
    return least


def _straddles(corners: Array, half_m: Array) -> Mask:
    """Whether neither side of the rectangle separates it from the corners, shape (n,)."""
    meets: Mask = ((corners.min(axis=1) <= half_m) & (corners.max(axis=1) >= -half_m)).all(axis=1)
    return meets


def least_hull_distance(tracks: HullTracks, one: int, other: int) -> tuple[float, float]:
    """Least distance of two hulls over a drive, between its times too, and a time at which they are so near.

    An interval is halved as long as its hulls could come nearer than the least distance so far by more than
    `TOLERANCE_M`: a distance changes by no more than the centres move against each other and the corners swing.

    Returns:
        The distance in metres and the time in seconds; infinite and NaN if the two are never there together.
    """
    at = _Pair(tracks, one, other)
    distance = at(tracks.times_s)
    if not np.isfinite(distance).any():
        return np.inf, np.nan
    nearest = int(np.argmin(distance))
    best, when = float(distance[nearest]), float(tracks.times_s[nearest])
    both = np.flatnonzero(np.isfinite(distance[:-1]) & np.isfinite(distance[1:]))
    begin, end, change = tracks.times_s[both], tracks.times_s[both + 1], at.most_change_m()[both]
    near, far = distance[both], distance[both + 1]
    for _ in range(_MAX_HALVINGS):
        open_ = (near + far - change) / 2 < best - TOLERANCE_M
        if best <= 0 or not open_.any():
            break
        begin, end, near, far, change = (values[open_] for values in (begin, end, near, far, change / 2))
        middle = (begin + end) / 2
        found = at(middle)
        if found.min() < best:
            best, when = float(found.min()), float(middle[np.argmin(found)])
        begin, end = np.concatenate([begin, middle]), np.concatenate([middle, end])
        near, far, change = np.concatenate([near, found]), np.concatenate([found, far]), np.tile(change, 2)
    return best, when


class _Pair:
    """Two of the hulls."""

    def __init__(self, tracks: HullTracks, one: int, other: int) -> None:
        self._times_s, self._half_m = tracks.times_s, tracks.half_sizes_m[[one, other]]
        self._centres_m = tracks.centres_m[:, [one, other]]
        known = np.isfinite(tracks.headings_rad[:, [one, other]])
        # From step to step the shorter way round; an absent vessel keeps its heading, and its place is NaN.
        turned = (np.diff(np.where(known, tracks.headings_rad[:, [one, other]], 0.0), axis=0) + np.pi) % (2 * np.pi)
        start = np.where(known[:1], tracks.headings_rad[:1, [one, other]], 0.0)
        self._headings_rad = np.concatenate([start, start + np.cumsum(turned - np.pi, axis=0)])

    def __call__(self, times_s: Array) -> Array:
        """Distance at some times, shape (n,); infinite where one is absent."""
        last = len(self._times_s) - 1
        leg = np.clip(np.searchsorted(self._times_s, times_s, side="right") - 1, 0, max(last - 1, 0))
        after = np.minimum(leg + 1, last)
        span = self._times_s[after] - self._times_s[leg]
        share = ((times_s - self._times_s[leg]) / np.where(span > 0, span, 1.0))[:, None, None]
        # At a known time only that time counts: its neighbour may be absent.
        start, end = self._centres_m[leg], self._centres_m[after]
        centres = np.where(share == 0, start, np.where(share == 1, end, start + share * (end - start)))
        turns = self._headings_rad[leg] + share[:, 0] * (self._headings_rad[after] - self._headings_rad[leg])
        there = np.isfinite(centres).all(axis=(1, 2))
        found = np.full(len(times_s), np.inf)
        half = np.broadcast_to(self._half_m, (int(there.sum()), 2, 2))
        one, other = (Rectangles(centres[there, i], turns[there, i], half[:, i]) for i in (0, 1))
        found[there] = rectangle_distances(one, other)
        return found

    def most_change_m(self) -> Array:
        """How much the distance changes at most from each time to the next, shape (S − 1,)."""
        moved = np.diff(self._centres_m[:, 1] - self._centres_m[:, 0], axis=0)
        swing = np.abs(np.diff(self._headings_rad, axis=0)) @ np.hypot(self._half_m[:, 0], self._half_m[:, 1])
        change: Array = np.hypot(moved[:, 0], moved[:, 1]) + swing
        return change
