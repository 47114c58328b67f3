"""Statistics of traffic: kinds of encounter by the collision regulations (COLREG), densities, lanes and speeds."""

from collections.abc import Sequence
from enum import Enum

import numpy as np

from modsim3d.core.arrays import Array, Mask
from modsim3d.geometry.kinematics import HullTracks
from modsim3d.world.poses.base import PoseSource, times_s
from modsim3d.world.vessels import Vessel

ABAFT_THE_BEAM_RAD = np.pi / 2 + np.radians(22.5)  # rule 13: who comes up from further aft of the other overtakes
NEARLY_RECIPROCAL_RAD = np.radians(11.25)
"""Rule 14: vessels that meet on nearly reciprocal courses. The rule has no number; we take one point of the compass."""


class Encounter(Enum):
    """Kinds of encounter of one vessel with another, which decide who gives way (COLREG rules 13 to 15)."""

    HEAD_ON = "head-on: both alter course to starboard"
    OVERTAKING = "overtakes the other, and keeps clear"
    OVERTAKEN = "is overtaken, and stands on"
    GIVES_WAY = "crossing, the other to starboard: gives way"
    STANDS_ON = "crossing, the other to port: stands on"


def encounter(place_m: Array, heading_rad: float, other_m: Array, other_heading_rad: float) -> Encounter:
    """The kind of encounter of a vessel with another that comes nearer, by their bearings from each other.

    Args:
        place_m: Place of the vessel, shape (2,).
        heading_rad: Its heading, counter-clockwise from w1.
        other_m: Place of the other, shape (2,).
        other_heading_rad: The other's heading.
    """
    sees = relative_bearing(place_m, heading_rad, other_m)
    is_seen = relative_bearing(other_m, other_heading_rad, place_m)
    if abs(sees) > ABAFT_THE_BEAM_RAD:
        return Encounter.OVERTAKEN
    if abs(is_seen) > ABAFT_THE_BEAM_RAD:
        return Encounter.OVERTAKING
    reciprocal = abs(_wrapped(other_heading_rad - heading_rad + np.pi))
    if reciprocal <= NEARLY_RECIPROCAL_RAD:
        return Encounter.HEAD_ON
    return Encounter.GIVES_WAY if sees > 0 else Encounter.STANDS_ON


def relative_bearing(place_m: Array, heading_rad: float, other_m: Array) -> float:
    """Bearing of another from a vessel's bow in radians, in [−π, π]; positive to starboard."""
    offset = other_m - place_m
    return -_wrapped(float(np.arctan2(offset[1], offset[0])) - heading_rad)


def _wrapped(angle_rad: float) -> float:
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def hull_tracks(vessels: Sequence[Vessel], poses: PoseSource, steps: int) -> HullTracks:
    """The hulls of vessels at all steps."""
    places = poses.poses(0, steps)
    return HullTracks(
        times_s=times_s(poses.timestamps, 0, steps),
        centres_m=np.where(places.present[..., None], places.positions_m[..., :2], np.nan),
        headings_rad=np.where(places.present, places.headings_rad, np.nan),
        half_sizes_m=np.array([(vessel.length_m / 2, vessel.beam_m / 2) for vessel in vessels]).reshape(-1, 2),
    )


def speeds_m_s(tracks: HullTracks) -> Array:
    """Speeds of n vessels between S times, shape (S − 1, n); NaN where a vessel is absent at either."""
    moved = np.diff(tracks.centres_m, axis=0)
    return np.hypot(moved[..., 0], moved[..., 1]) / np.diff(tracks.times_s)[:, None]


def inside(polygon_m: Array, places_m: Array) -> Mask:
    """Whether places of shape (..., 2) lie in a polygon with the corners (k, 2), by counting sides beside them."""
    start, end = polygon_m, np.roll(polygon_m, -1, axis=0)
    x, y = places_m[..., 0, None], places_m[..., 1, None]
    crosses = (start[:, 1] > y) != (end[:, 1] > y)
    rise = end[:, 1] - start[:, 1]
    at = start[:, 0] + (y - start[:, 1]) * (end[:, 0] - start[:, 0]) / np.where(rise == 0, 1.0, rise)
    odd: Mask = (crosses & (x < at)).sum(axis=-1) % 2 == 1
    return odd


def density_per_km2(tracks: HullTracks, polygon_m: Array) -> float:
    """Mean number of vessels over all times in a polygon with the corners (k, 2), for each square kilometre of it."""
    after = np.roll(polygon_m, -1, axis=0)
    area_m2 = abs(float((polygon_m[:, 0] * after[:, 1] - after[:, 0] * polygon_m[:, 1]).sum())) / 2
    return float(inside(polygon_m, tracks.centres_m).sum(axis=1).mean()) / area_m2 * 1e6


def lane_offsets(waypoints_m: Array, places_m: Array) -> tuple[Array, Array]:
    """Position of places of shape (n, 2) along and beside a line through waypoints of shape (k, 2).

    Returns:
        Distance along the line to the nearest point on it, and the distance from there, positive to starboard of one
        who follows the line; both in metres, of shape (n,).
    """
    leg = np.diff(waypoints_m, axis=0)
    length = np.hypot(leg[:, 0], leg[:, 1])
    along = leg / length[:, None]
    offset = places_m[:, None] - waypoints_m[:-1]
    reached = np.clip((offset * along).sum(axis=-1), 0.0, length)
    apart = offset - reached[..., None] * along
    distance = np.hypot(apart[..., 0], apart[..., 1])
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(places_m))
    to_port = along[nearest, 0] * apart[rows, nearest, 1] - along[nearest, 1] * apart[rows, nearest, 0]
    start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    return start[nearest] + reached[rows, nearest], -np.sign(to_port) * distance[rows, nearest]
