"""Finds the positions of a track that no ship can have reached."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices, Mask


def reachable(times_s: Array, places_m: Array, max_speed_m_s: float, slack_s: float) -> Mask:
    """The largest part of a track in which each position can be reached from the one before.

    The track is cut wherever the speed between neighbours is too high. Of the chains of pieces in which each piece can
    be reached from the one before, the one with most positions is kept. So a single wrong position is dropped wherever
    it stands, also at the beginning, and of two vessels that share an identity the one with more reports is kept.

    Args:
        times_s: Ascending, shape (n,).
        places_m: East and north, shape (n, 2).
        max_speed_m_s: A position that asks for more speed cannot be reached.
        slack_s: Added to each interval, because times are rounded.

    Returns:
        Which positions are kept, shape (n,).
    """

    def possible(start: Indices, end: Indices) -> Mask:
        way = np.linalg.norm(places_m[end] - places_m[start], axis=-1)
        return np.asarray(way <= max_speed_m_s * (times_s[end] - times_s[start] + slack_s))

    number = len(times_s)
    places = np.arange(number)
    cuts = np.flatnonzero(~possible(places[:-1], places[1:])) + 1 if number > 1 else np.zeros(0, dtype=np.int64)
    if not len(cuts):
        return np.ones(number, dtype=bool)
    firsts, stops = np.r_[0, cuts], np.r_[cuts, number]
    best = np.zeros(len(firsts), dtype=np.int64)
    before = np.full(len(firsts), -1)
    for piece, (first, stop) in enumerate(zip(firsts, stops, strict=True)):
        best[piece] = stop - first
        reached = np.flatnonzero(possible(stops[:piece] - 1, first))
        if len(reached):
            before[piece] = reached[np.argmax(best[reached])]
            best[piece] += best[before[piece]]
    kept = np.zeros(number, dtype=bool)
    piece = int(np.argmax(best))
    while piece >= 0:
        kept[firsts[piece] : stops[piece]] = True
        piece = int(before[piece])
    return kept
