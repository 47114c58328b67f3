"""A vessel's track at the times of a scene, from reports at irregular times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask

TRUST_M, TRUST_SHARE = 15.0, 0.25
"""Two reported velocities are used if their mean times the interval misses the way between the positions by at most
TRUST_M plus TRUST_SHARE of that way."""
ROUNDING_S = 1e-6


@dataclass(frozen=True, eq=False)
class ReportedTrack:
    """Reports of one vessel, with the places of its antenna.

    Attributes:
        times_s: Ascending, shape (n,).
        places_m: East and north, shape (n, 2).
        velocities_m_s: East and north, NaN where unknown, shape (n, 2).
        headings_rad: Counter-clockwise from w1, shape (n,).
    """

    times_s: Array
    places_m: Array
    velocities_m_s: Array
    headings_rad: Array


def steps_near(known_s: Array, times_s: Array, max_gap_s: float) -> Indices:
    """The times, shape (m,) ascending, at which a vessel with some reports may be there, as indices, shape (k,).

    These are all from one report, shape (n,) ascending, to the next, where they are not further apart than the longest
    gap, and those at a report. A vessel with a few reports costs little then, however long the scene is.
    """
    joined = np.append(np.diff(known_s) <= max_gap_s, False)
    last = np.where(joined, np.append(known_s[1:], known_s[-1:]), known_s)
    stops = np.searchsorted(times_s, last + ROUNDING_S, side="right")
    starts = np.searchsorted(times_s, known_s - ROUNDING_S, side="left")
    starts = np.maximum(starts, np.maximum.accumulate(np.append(0, stops[:-1])))
    counts = np.maximum(stops - starts, 0)
    return np.repeat(starts - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())


def resample(track: ReportedTrack, times_s: Array, max_gap_s: float) -> tuple[Mask, Array, Array]:
    """Whether a vessel is there at some times, shape (m,), its places in metres, (m, 2), and headings in radians, (m,).

    Between two reports the vessel follows the cubic with the reported velocities at both ends (cubic Hermite
    interpolation), or a straight line where these are unknown or do not fit the positions. Its heading turns evenly
    along the shorter arc. The vessel is away before the first report, after the last, and between reports that are
    further apart than the longest gap.
    """
    known = track.times_s
    if len(known) == 1:
        there = np.abs(times_s - known[0]) <= ROUNDING_S
        return there, np.repeat(track.places_m, len(times_s), axis=0), np.full(len(times_s), track.headings_rad[0])
    within = (times_s >= known[0] - ROUNDING_S) & (times_s <= known[-1] + ROUNDING_S)
    leg = np.clip(np.searchsorted(known, times_s, side="right") - 1, 0, len(known) - 2)
    span_s = known[leg + 1] - known[leg]
    share = np.clip((times_s - known[leg]) / span_s, 0.0, 1.0)
    on_report = np.minimum(share, 1 - share) * span_s <= ROUNDING_S
    there = within & ((span_s <= max_gap_s) | on_report)
    turn = np.diff(track.headings_rad)
    turn = np.arctan2(np.sin(turn), np.cos(turn))
    return there, _places(track, leg, share), track.headings_rad[leg] + share * turn[leg]


def _places(track: ReportedTrack, leg: Indices, share: Array) -> Array:
    span_s = np.diff(track.times_s)[:, None]
    way = np.diff(track.places_m, axis=0)
    leaving, arriving = track.velocities_m_s[:-1] * span_s, track.velocities_m_s[1:] * span_s
    miss = np.linalg.norm((leaving + arriving) / 2 - way, axis=1)
    trusted = miss <= TRUST_M + TRUST_SHARE * np.linalg.norm(way, axis=1)  # false where one is unknown
    leaving, arriving = (np.where(trusted[:, None], velocity, way) for velocity in (leaving, arriving))
    u = share[:, None]
    # Hermite's basis, as what is added to the straight line: it vanishes where both velocities are the mean one.
    bend = u * (1 - u) * ((1 - u) * (leaving - way)[leg] - u * (arriving - way)[leg])
    return np.asarray((1 - u) * track.places_m[leg] + u * track.places_m[leg + 1] + bend)


def to_hull_centre(antenna_m: Array, headings_rad: Array, ahead_m: float, to_port_m: float) -> Array:
    """Places of a hull's centre from those of its antenna, shape (m, 2), at headings counter-clockwise from w1, (m,).

    The centre lies `ahead_m` ahead of the antenna and `to_port_m` to port of it.
    """
    cosine, sine = np.cos(headings_rad), np.sin(headings_rad)
    offset = np.stack([ahead_m * cosine - to_port_m * sine, ahead_m * sine + to_port_m * cosine], axis=-1)
    return antenna_m + offset
