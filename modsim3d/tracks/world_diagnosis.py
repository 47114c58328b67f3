"""Tracks in the world that are wrong as a whole: read in another way they fit where vessels are.

The rules are those of tracks in images (`modsim3d.tracks.files.diagnosis`), with the places of vessels but own ship.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.closest_approach import HullTracks

_LOOKED_AT, _LEAST_ROWS, _LEAST_STEP_ROWS = 2000, 8, 30
"""Rows, spread over the file; fewer fit by chance, and more are needed where little changes."""
_FITS, _FITS_M, _NEARER, _MUCH, _STEP = 0.03, 50.0, 0.6, 3.0, 1.5
"""Another reading is meant if positions are at most this share of the vessels' extent from one, and this far, the gate
of `score`; this share of them is, and nearer than as the file is; and half of them by this factor, or by that where
they are a step off. A looser fit says nothing: so near to some vessel come tracks that are poor or false."""
_SCALES = {"kilometres": 1000.0, "nautical miles": 1852.0, "feet": 0.3048, "centimetres": 0.01, "millimetres": 0.001}
_MIRRORED = {"w1_m counts": (-1, 1), "w2_m counts": (1, -1), "w1_m and w2_m count": (-1, -1)}
_RELATIVE = "the positions are relative to own ship, must be from the scene's zero"


def world_misreading(time_s: Array, position_m: Array, hulls: HullTracks, own: tuple[int, ...]) -> str:
    """What is wrong with positions (k, 2) that are near vessels only if they are read in another way; empty if nothing.

    `hulls` are the vessels at all steps, and `own` the columns of those that carry cameras.
    """
    vessels_m = np.delete(hulls.centres_m, own, axis=1)
    if len(time_s) < _LEAST_ROWS or np.isnan(vessels_m).all():
        return ""
    rows = np.unique(np.linspace(0, len(time_s) - 1, _LOOKED_AT).astype(np.int64))
    step = np.rint(np.interp(time_s[rows], hulls.times_s, np.arange(len(hulls.times_s)))).astype(np.int64)
    as_it_is = _nearest_m(position_m[rows], vessels_m[step])
    now, meant = float(np.median(as_it_is)), ""
    extent_m = float(np.hypot(*(np.nanmax(vessels_m, axis=(0, 1)) - np.nanmin(vessels_m, axis=(0, 1)))))
    best = limit = min(_FITS * extent_m, _FITS_M)
    for told, places_m, at in _readings(position_m[rows], step, hulls, own):
        away = _nearest_m(places_m, vessels_m[at])
        factor, least = (_MUCH, _LEAST_ROWS) if at is step else (_STEP, _LEAST_STEP_ROWS)
        half, nearer = float(np.median(away)), ((away < as_it_is) & (away < limit)).mean() >= _NEARER
        if half < best and now > factor * half and nearer and len(rows) >= least:
            best, meant = half, told
    return meant and f"{meant} (then half of them are within {best:.3g} m of a vessel instead of {now:.3g} m)"


def _readings(
    position_m: Array, step: Indices, hulls: HullTracks, own: tuple[int, ...]
) -> Iterator[tuple[str, Array, Indices]]:
    """What is wrong in each other reading, and the places and steps of the rows in it."""
    yield "w1_m and w2_m of the positions are exchanged", position_m[:, ::-1], step
    for signs in ((1, -1), (-1, 1)):
        yield "the positions are turned by a right angle", position_m[:, ::-1] * signs, step
    for told, signs in _MIRRORED.items():
        yield f"{told} the other way round in the positions, as in mirrored or turned axes", position_m * signs, step
    for unit, scale in _SCALES.items():
        yield f"the positions seem to be {unit}, must be metres", position_m * scale, step
    for column in own[:1]:
        own_m, heading, (ahead, port) = hulls.centres_m[step, column], hulls.headings_rad[step, column], position_m.T
        turned = [np.cos(heading) * ahead - np.sin(heading) * port, np.sin(heading) * ahead + np.cos(heading) * port]
        yield _RELATIVE, position_m + own_m, step
        yield f"{_RELATIVE}, and along its axes, must be along w1 and w2", np.column_stack(turned) + own_m, step
    later = np.minimum(step + 1, len(hulls.times_s) - 1)
    yield "the times or steps of the positions are a step too low: was the first step left out?", position_m, later


def _nearest_m(position_m: Array, vessels_m: Array) -> Array:
    """Distance of each position from the nearest vessel of its step, shapes (k, 2) and (k, n, 2) to (k,)."""
    away = np.hypot(*np.moveaxis(vessels_m - position_m[:, None], -1, 0))
    nearest: Array = np.nan_to_num(away, nan=np.inf).min(axis=1)
    return nearest
