"""False positives that stay for a while: wakes, glints, buoys.

They exist in layers. In each layer they are born at random, one in each mean lifetime on average, and live for an
exponential time, so one exists at a time on average; each has a random height within its layer. A frame shows those
that lie below its rate: their number is exactly Poisson with that rate, however the rate changes from frame to frame,
and each lives as long as it would have anyway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from modsim3d.arrays import Array, Indices
from modsim3d.detector.draws import poisson_quantile
from modsim3d.detector.records import CameraFrames
from modsim3d.random_streams import Purpose, Streams

_LOOK_BACK = 38
"""Lifetimes that the oldest can have lived: −ln of the least positive uniform number, 2⁻⁵³, is below 37."""
_WIDTH = 8  # birth, lifetime, height, place (3), size, label


@dataclass(frozen=True, eq=False)
class PersistentClutter:
    """Persistent false positives, a row for each frame that shows one.

    Attributes:
        frame: Index of the frame, non-decreasing, shape (m,).
        age_s: Time since birth, shape (m,).
        uniforms: Uniform numbers for place (3), size and label, the same in all frames of one, shape (m, 5).
        sign: Direction in which it drifts, 1 or −1, shape (m,).
    """

    frame: Indices
    age_s: Array
    uniforms: Array
    sign: Array


def persistent_clutter(streams: Streams, frames: CameraFrames, rates: Array, lifetime_s: float) -> PersistentClutter:
    """Persistent false positives in a camera's frames, given their mean number in each, shape (S,), and lifetime."""
    count = int(np.ceil(rates.max(initial=0.0)))
    layers = [_layer(streams, frames, rates - layer, lifetime_s, layer) for layer in range(count)]
    if not layers:
        nothing, none = np.empty(0), np.empty(0, dtype=np.int64)
        return PersistentClutter(none, nothing, np.empty((0, 5)), nothing)
    frame, age, draws = (np.concatenate(columns) for columns in zip(*layers, strict=True))
    order = np.argsort(frame, kind="stable")
    frame, draws = frame[order], draws[order]
    # The last binary digit of the birth, which nothing else can tell, says which way.
    odd = (draws[:, 0] * 2.0**53).astype(np.int64) % 2 == 1
    return PersistentClutter(frame, age[order], draws[:, 3:], np.where(odd, 1.0, -1.0))


def _layer(
    streams: Streams, frames: CameraFrames, rates: Array, lifetime_s: float, layer: int
) -> tuple[Indices, Array, Array]:
    """Frame, age and draws of what a layer shows at rates above its bottom."""
    wanted = np.flatnonzero(rates > 0)
    if not len(wanted):
        return np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, _WIDTH))
    times = frames.times_s[wanted]
    first = int(times[0] // lifetime_s) - _LOOK_BACK
    count = int(times[-1] // lifetime_s) + 1 - first
    cells, draws = _births(streams, frames.camera, str(layer), first, count)
    born = (cells + draws[:, 0]) * lifetime_s
    lived = -special.log1p(-draws[:, 1]) * lifetime_s
    begin, end = np.searchsorted(times, born), np.searchsorted(times, born + lived)
    seen = end - begin
    one = np.repeat(np.arange(len(born)), seen)
    row = np.arange(len(one)) - np.repeat(np.cumsum(seen) - seen - begin, seen)
    low = draws[one, 2] < rates[wanted[row]]
    row, one = row[low], one[low]
    return wanted[row], times[row] - born[one], draws[one]


def _births(streams: Streams, camera: str, layer: str, first: int, count: int) -> tuple[Indices, Array]:
    """Cell of time and draws of each birth in `count` cells; a cell is a mean lifetime long."""
    index = first + _LOOK_BACK  # the first cells lie before the scene's first step
    numbers = streams.uniforms(Purpose.PERSISTENT_BIRTHS, camera, layer, first=index, count=count)[:, 0]
    births = poisson_quantile(numbers, np.ones(count))
    cells, draws = [np.empty(0, dtype=np.int64)], [np.empty((0, _WIDTH))]
    for k in range(int(births.max(initial=0))):
        some = streams.uniforms(Purpose.PERSISTENT, camera, layer, str(k), first=index, count=count)
        ours = np.flatnonzero(births > k)
        cells.append(first + ours)
        draws.append(some[ours])
    order = np.argsort(np.concatenate(cells), kind="stable")
    return np.concatenate(cells)[order], np.concatenate(draws)[order]
