"""False detections linked over time: which of them are the same thing, seen again.

In each frame the detections are assigned to the things of the frames before: as many as possible, and of those the
least sum of distances to where each thing is expected. Things move at a constant velocity, along and below the
horizon, so that a camera that rolls and pitches does not break the links.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.arrays import Array, Indices
from modsim3d.formats.labelled import Images
from modsim3d.learn.observed.observed import Observed

MOST_GAP_S = 3.0
"""A thing that is not detected for longer is another one when it is detected again."""
LEAST_GAP_FRAMES = 3
"""Usual gaps between frames that a thing may be missed for in any case."""
_NEAR, _LEAST_NEAR_PX = 0.6, 5.0
"""How far off a box may lie, in sides of it, and in pixels."""
_SPEED_SIDES_S = 1.0
"""How fast a thing may be, in lengths a second: a boat of 10 m at 20 knots makes one."""
_MOST_WAY_SIDES = 2.0
_MOST_LOG_RATIO = np.log(2.0)
_MEMORY = 12
"""Detections that a velocity is made from."""


@dataclass(frozen=True, eq=False)
class Links:
    """Which detections are of one thing.

    Attributes:
        rows: Rows of the results that are linked, shape (n,).
        link: Number of the thing that each is of, from 0 up, shape (n,).
        image: Image of each, shape (n,).
        time_s: Time of each, shape (n,).
        places_px: Distance along and below the horizon of the centre, shape (n, 2).
        bottom_px: Distance below the horizon of the middle of the lower edge, NaN where no horizon is known, (n,).
        sizes_px: Width and height, shape (n, 2).
        gap_s: Usual time between frames.
        longest_gap_s: Longest time between two detections of one thing.
    """

    rows: Indices
    link: Indices
    image: Indices
    time_s: Array
    places_px: Array
    bottom_px: Array
    sizes_px: Array
    gap_s: float
    longest_gap_s: float

    @property
    def count(self) -> int:
        """Number of things."""
        return int(self.link.max(initial=-1)) + 1


@dataclass
class _Things:
    """The things that are followed in one sequence, one entry each."""

    number: list[int] = field(default_factory=list)
    seen: list[int] = field(default_factory=list)
    last_s: list[float] = field(default_factory=list)
    state: list[Array] = field(default_factory=list)
    """Place, velocity and logarithms of the sides, shape (6,)."""

    def drop_before(self, time_s: float) -> None:
        """Forget the things that were last seen before a time."""
        kept = [k for k, last in enumerate(self.last_s) if last >= time_s]
        for name in ("number", "seen", "last_s", "state"):
            values = getattr(self, name)
            setattr(self, name, [values[k] for k in kept])


def link(observed: Observed) -> Links:
    """Link the false positives of a labelled set whose images have times; others are things of their own."""
    sightings, images = observed.false_sightings, observed.labelled.images
    time_s = images.time_s[sightings.image]
    gap_s = _usual_gap_s(images)
    longest = max(MOST_GAP_S, (LEAST_GAP_FRAMES + 0.5) * gap_s)
    places = np.column_stack([sightings.along_px, sightings.depth_px])
    bottom = sightings.depth_px + sightings.sizes_px[:, 1] / 2
    numbers = np.full(len(sightings), -1)
    logs, first = np.log(sightings.sizes_px), 0
    sequence = images.sequence[sightings.image]
    for each in np.unique(sequence[np.isfinite(time_s)]):
        rows = np.flatnonzero((sequence == each) & np.isfinite(time_s))
        rows = rows[np.argsort(time_s[rows], kind="stable")]
        first = _follow(rows, time_s, np.column_stack([places, logs]), longest, numbers, first)
    alone = np.flatnonzero(numbers < 0)
    numbers[alone] = first + np.arange(len(alone))
    return Links(
        observed.false_positives,
        numbers,
        sightings.image,
        time_s,
        places,
        np.where(sightings.known, bottom, np.nan),
        sightings.sizes_px,
        gap_s,
        longest,
    )


def _follow(rows: Indices, time_s: Array, measured: Array, longest_s: float, numbers: Indices, first: int) -> int:
    """Number the rows of one sequence, in order of time, from `first` on; gives the next free number."""
    things = _Things()
    edges = np.flatnonzero(np.diff(time_s[rows])) + 1
    for ours in np.split(rows, edges) if len(rows) else []:
        now = float(time_s[ours[0]])
        things.drop_before(now - longest_s - 1e-9)
        taken = _assigned(things, now, measured[ours])
        for place, thing in taken:
            numbers[ours[place]] = things.number[thing]
            _update(things, thing, now, measured[ours[place]])
        for row in np.delete(ours, [place for place, _ in taken]).tolist():
            numbers[row] = first
            things.number.append(first)
            things.seen.append(1)
            things.last_s.append(now)
            things.state.append(np.concatenate([measured[row, :2], np.zeros(2), measured[row, 2:]]))
            first += 1
    return first


def _assigned(things: _Things, now: float, measured: Array) -> list[tuple[int, int]]:
    """Pairs of a detection and the thing that it is of, as places; measured are place and log sides, (n, 4)."""
    if not things.number:
        return []
    state, apart = np.stack(things.state), now - np.array(things.last_s)
    side = np.exp(state[:, 4:].mean(axis=1))
    way = np.minimum(apart * _SPEED_SIDES_S, _MOST_WAY_SIDES) / np.sqrt(np.array(things.seen))
    reach = np.maximum(_NEAR * side, _LEAST_NEAR_PX) + side * way
    expected = state[:, :2] + state[:, 2:4] * apart[:, None]
    off = np.linalg.norm(measured[:, None, :2] - expected[None], axis=-1) / reach
    alike = (np.abs(measured[:, None, 2:] - state[None, :, 4:]) <= _MOST_LOG_RATIO).all(axis=-1)
    fits = alike & (off <= 1)
    if not fits.any():
        return []
    cost = np.where(fits, off, 2.0 * min(off.shape) + 2)
    pairs = zip(*linear_sum_assignment(cost), strict=True)
    return [(int(a), int(b)) for a, b in pairs if fits[a, b]]


def _update(things: _Things, thing: int, now: float, measured: Array) -> None:
    """Move a thing to where it was detected, by least squares over its last detections."""
    state, apart = things.state[thing].copy(), now - things.last_s[thing]
    count = min(things.seen[thing] + 1, _MEMORY)
    expected = state[:2] + state[2:4] * apart
    off = measured[:2] - expected
    # Gains of a straight line through the last detections, evenly spaced (Brookner (1998), section 1.2.10).
    state[:2] = expected + 2 * (2 * count - 1) / (count * (count + 1)) * off
    state[2:4] += 6 / (count * (count + 1)) * off / apart
    state[4:] += (measured[2:] - state[4:]) / count
    things.state[thing], things.last_s[thing] = state, now
    things.seen[thing] += 1


def _usual_gap_s(images: Images) -> float:
    """Median time between consecutive frames; 1 where frames have no times."""
    order = np.lexsort((images.time_s, images.sequence))
    gaps = np.diff(images.time_s[order])[np.diff(images.sequence[order]) == 0]
    gaps = gaps[gaps > 0]
    return float(np.median(gaps)) if len(gaps) else 1.0
